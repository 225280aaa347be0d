import random
from types import SimpleNamespace
import pytest
from players.logs.clock_steps import ClockSteps, Timed

MS, S = 1_000_000, 1_000_000_000
TOPICS = {name: (period * MS, delay * MS) for name, period, delay in (
    ("color", 100, 40), ("depth", 166, 55), ("odom", 20, 2), ("tf", 33, 4),
)}  # fmt: skip
MIDDLE = 2 * S


def _stream(change=lambda topic, stamp, log: (stamp, log)):
    """Return messages in the order of arrival, each with its true stamp; `change` sees stamps that begin with 0."""
    rows = []
    for topic, (period, delay) in TOPICS.items():
        for true in range(0, 4 * S, period):
            stamp, log = change(topic, true, true + delay)
            rows.append((max(log, true + delay), Timed(topic, stamp + 100 * S, log + 100 * S, true)))
    return [timed for _, timed in sorted(rows, key=lambda row: row[0])]


def _set(step, *topics, with_log=False):
    def change(topic, stamp, log):
        is_set = stamp >= MIDDLE and topic in (topics or TOPICS)
        return stamp + step * is_set, log + step * (is_set and with_log)

    return change


def _numbered(messages):
    clock = ClockSteps()
    found = [((timed.topic, timed.message), number) for timed, number in clock.numbered(messages)]
    assert [key for key, _ in found] == [(timed.topic, timed.message) for timed in messages]
    return clock, dict(found)


@pytest.mark.parametrize("with_log", [False, True])
@pytest.mark.parametrize("back_s", [0.1, 0.3, 0.8, 3.0, 60.0])
def test_a_step_back_divides_every_topic_where_it_happens(back_s, with_log):
    clock, numbers = _numbered(_stream(_set(-round(back_s * S), with_log=with_log)))
    assert len({key for key, number in numbers.items() if number != (key[1] >= MIDDLE)}) <= (4 if with_log else 0)
    assert list(clock.texts.values()) == [False]
    assert f"clock was set back by {back_s:.2f} s" in next(iter(clock.texts))


@pytest.mark.parametrize("ahead_s", [0.1, 0.8, 60.0])
def test_a_step_ahead_is_reported_and_divides_nothing(ahead_s):
    clock, numbers = _numbered(_stream(_set(round(ahead_s * S))))
    assert set(numbers.values()) == {0}
    assert f"clock was set ahead by {ahead_s:.2f} s" in next(iter(clock.texts))


def test_two_steps_are_counted():
    back = 400 * MS
    _, numbers = _numbered(_stream(lambda topic, s, log: (s - back * (s >= S) - back * (s >= 3 * S), log)))
    assert {key: (key[1] >= S) + (key[1] >= 3 * S) for key in numbers} == numbers


@pytest.mark.parametrize("topics", [("odom",), ("color", "depth"), ("odom", "tf", "depth")])
@pytest.mark.parametrize("step_s", [-3.0, -0.8, -0.1, 0.5, 20.0])
def test_a_step_of_some_topics_alone_is_corrected(topics, step_s):
    clock, messages = ClockSteps(), _stream(_set(round(step_s * S), *topics))
    found = list(clock.numbered(messages))
    assert {number for _, number in found} == {0}
    assert all(timed.stamp_ns == timed.message + 100 * S for timed, _ in found)
    assert list(clock.texts.values()) == [False]
    way = "back" if step_s < 0 else "ahead"
    assert f"alone was set {way} by {abs(step_s):.2f} s" in next(iter(clock.texts))


@pytest.mark.parametrize("back_s", [0.3, 0.81, 1.5])
def test_a_log_sorted_after_a_step_loses_its_mixed_times(back_s):
    rows = sorted(_stream(_set(-round(back_s * S), with_log=True)), key=lambda timed: timed.log_ns)
    rows = [t._replace(message=SimpleNamespace(true=t.message, data=b"%d" % t.message)) for t in rows]
    clock = ClockSteps()
    found = [(timed, number) for timed, number in clock.numbered(rows) if number >= 0]
    # Only the second message of a stream shows that it is one of two.
    wrong = [timed.topic for timed, number in found if number != (timed.message.true >= MIDDLE)]
    assert len(wrong) == len(set(wrong))
    assert len(found) > len(rows) * (1 - 1.5 * back_s / 2)
    ((text, is_harmful),) = clock.texts.items()
    assert "messages of two times are mixed" in text
    assert is_harmful


def test_messages_that_were_recorded_twice_are_not_mixed_times():
    rows = [timed._replace(message=SimpleNamespace(data=b"the same")) for timed in _stream()]
    again = [timed for timed in rows if S < timed.log_ns - 100 * S < 2 * S]
    clock = ClockSteps()
    found = list(clock.numbered(sorted([*rows, *again], key=lambda timed: timed.log_ns)))
    assert [number for _, number in found] == [0] * len(found)
    assert clock.texts == {}


def test_a_second_publisher_is_not_taken_for_mixed_times():
    extra = [t._replace(stamp_ns=t.stamp_ns + 9 * MS, log_ns=t.log_ns + 9 * MS, message=-1) for t in _stream()]
    extra = [timed for timed in extra if timed.topic in ("odom", "tf") and timed.log_ns > 102 * S]
    found = list(ClockSteps().numbered(sorted([*_stream(), *extra], key=lambda timed: timed.log_ns)))
    assert {number for _, number in found} == {0}


def _stalled(topic, stamp, log):
    return stamp, max(log, 3 * S + (log - S) // 1000) if S < log < 3 * S else log


def _lasting(topic, stamp, log):
    return stamp, log + 600 * MS * (stamp >= MIDDLE)


def _jittered(spread):
    rng = random.Random(7)
    return lambda topic, stamp, log: (stamp, log + rng.randrange(spread))


@pytest.mark.parametrize(
    "delay",
    [
        _stalled, _jittered(30 * MS), _jittered(200 * MS), _lasting,
        lambda topic, stamp, log: (stamp, log + stamp // 20), lambda topic, stamp, log: (stamp, log // 5),
        lambda topic, stamp, log: (stamp, log // 5 + log * (stamp >= MIDDLE)),
        lambda topic, stamp, log: (stamp, log + 150 * MS * (topic == "color" and stamp % S < 100 * MS)),
        lambda topic, stamp, log: (stamp - 10 * S * (topic == "tf" and stamp % S < 33 * MS), log),
    ],
    ids="stall jitter much-jitter lasting-delay drift fast-replay slower-replay late-images wrong-stamp".split(),
)  # fmt: skip
def test_delays_and_single_stamps_are_no_steps(delay):
    clock, numbers = _numbered(_stream(delay))
    assert clock.texts == {}
    assert set(numbers.values()) == {0}


@pytest.mark.parametrize("delay", [_stalled, _lasting, _jittered(200 * MS)], ids=["stall", "lasting", "jitter"])
def test_delayed_messages_hold_back_none_behind_them(delay):
    arriving = iter(messages := _stream(delay))
    for i, (timed, _) in enumerate(ClockSteps().numbered(arriving), 1):
        assert (timed, arriving.__length_hint__()) == (messages[i - 1], len(messages) - i)


def test_a_file_in_no_order_of_time_has_no_steps():
    messages = _stream()
    chunks = [messages[i : i + 30] for i in range(0, len(messages), 30)]
    clock, _ = _numbered([timed for chunk in chunks for timed in sorted(chunk, key=lambda t: (t.topic, t.log_ns))])
    assert clock.texts == {}
