import asyncio
from hypothesis import given
from hypothesis import strategies as st
from hickory_stream.engine.async_tools import Pacer

SECOND_NS = 1_000_000_000
# A second of log lasts eleven days: what has to wait, waits for longer than any test.
SLOW = 1e-6


def returns_at_once(pacer, stamp_ns):
    waiting = pacer.wait(stamp_ns)
    try:
        waiting.send(None)
    except StopIteration:
        return True
    waiting.close()
    return False


def in_loop(check):
    async def run():
        return check()

    return asyncio.run(run())


async def soon(awaitable):
    """Return whether something ends without waiting for a clock."""
    task = asyncio.ensure_future(awaitable)
    for _ in range(5):
        await asyncio.sleep(0)
    is_done = task.done()
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)
    return is_done


@given(st.lists(st.integers(0, 10**19)))
def test_as_fast_as_can_be_never_waits(stamps_ns):
    pacer = Pacer(None)
    assert all(returns_at_once(pacer, stamp_ns) for stamp_ns in stamps_ns)


def test_the_first_frame_is_due_at_once_and_a_later_one_is_not():
    pacer = Pacer(SLOW)
    assert in_loop(lambda: returns_at_once(pacer, 5 * SECOND_NS))
    assert in_loop(lambda: returns_at_once(pacer, 5 * SECOND_NS))
    assert not in_loop(lambda: returns_at_once(pacer, 6 * SECOND_NS))


def test_a_frame_whose_time_has_passed_is_due_at_once():
    pacer = Pacer(1e15)
    assert in_loop(lambda: all(returns_at_once(pacer, i * SECOND_NS) for i in range(1, 100)))


async def test_a_jump_back_starts_the_clock_anew():
    pacer = Pacer(SLOW)
    stamps_ns = [9 * SECOND_NS, 10 * SECOND_NS, 2 * SECOND_NS, 3 * SECOND_NS]
    assert [await soon(pacer.wait(stamp_ns)) for stamp_ns in stamps_ns] == [True, False, True, False]
