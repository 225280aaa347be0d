import pytest
from hypothesis import given
from hypothesis import strategies as st
from players.logs.timeline import BACKWARDS_NS, FORWARD_NS, Order, Timeline

S = 1_000_000_000


def _placed_ns(stamps_ns):
    timeline = Timeline()
    return [p for i, s in enumerate(stamps_ns) for p in timeline.add(s, i)] + timeline.end()


def _placed(stamps_s):
    return _placed_ns(round(s * S) for s in stamps_s)


DUE, LATE, TWICE, OFF = Order.IN_ORDER, Order.LATE, Order.DUPLICATE, Order.OFF


@pytest.mark.parametrize(("stamps_s", "orders", "epochs", "jumps_s"), [
    ([10, 10.1, 10.2], [DUE] * 3, [0] * 3, {}),
    ([10, 10.2, 10.1, 10.2, 10.3], [DUE, DUE, LATE, TWICE, DUE], [0] * 5, {}),
    ([100, 100.1, 0.0, 100.2, 100.3], [DUE, DUE, OFF, DUE, DUE], [0] * 5, {}),
    ([100, 100.1, 99999.0, 100.2, 100.3], [DUE, DUE, OFF, DUE, DUE], [0] * 5, {}),
    ([100, 100.1, 100.2, 50, 50.1, 50.2], [DUE] * 6, [0, 0, 0, 1, 1, 1], {3: -50.2}),
    ([100, 100.1, 200, 200.1], [DUE] * 4, [0] * 4, {2: 99.9}),
], ids="in-order late-and-double zero far looped pause".split())  # fmt: skip
def test_stamps_are_ordered_off_or_begin_another_epoch(stamps_s, orders, epochs, jumps_s):
    placed = sorted(_placed(stamps_s), key=lambda p: p.item)
    assert [(p.order, p.epoch) for p in placed] == list(zip(orders, epochs, strict=True))
    assert {p.item: p.jump_ns / S for p in placed if p.jump_ns} == pytest.approx(jumps_s)


def test_a_stream_slower_than_a_jump_is_played():
    placed = _placed([100.0 + 20 * i for i in range(6)])
    assert sum(p.order is Order.OFF for p in placed) <= 1
    assert {p.epoch for p in placed} == {0}


@given(st.lists(st.integers(0, 5 * FORWARD_NS), max_size=40))
def test_every_message_is_placed_exactly_once(stamps_ns):
    assert sorted(p.item for p in _placed_ns(stamps_ns)) == list(range(len(stamps_ns)))


@given(st.lists(st.integers(0, BACKWARDS_NS // 2), min_size=1, max_size=40, unique=True))
def test_disorder_within_half_a_second_is_never_a_jump(stamps_ns):
    assert all(p.order in (Order.IN_ORDER, Order.LATE) and p.epoch == 0 for p in _placed_ns(stamps_ns))
