import asyncio
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hickory_stream.engine.async_tools import Channel, ChannelClosed, Pacer, StopRequest


async def drain(channel, pauses):
    taken = []
    while True:
        for _ in range(pauses[len(taken) % len(pauses)] if pauses else 0):
            await asyncio.sleep(0)
        try:
            taken.append(await channel.receive())
        except ChannelClosed:
            return taken


async def fill(channel, items, pauses):
    for i, item in enumerate(items):
        for _ in range(pauses[i % len(pauses)] if pauses else 0):
            await asyncio.sleep(0)
        await channel.send(item)
    await channel.close()


PAUSES = st.lists(st.integers(0, 4), max_size=5)


@given(capacity=st.integers(1, 5), items=st.lists(st.integers()), slow_sender=PAUSES, slow_receiver=PAUSES)
def test_items_keep_their_order_and_capacity_holds(capacity, items, slow_sender, slow_receiver):
    async def pass_through():
        channel = Channel(capacity)
        taken, _ = await asyncio.gather(drain(channel, slow_receiver), fill(channel, items, slow_sender))
        return taken, channel

    taken, channel = asyncio.run(pass_through())
    assert taken == items
    statistics = channel.statistics()
    assert (statistics.length, statistics.capacity) == (0, capacity)
    assert statistics.peak <= min(capacity, len(items))
    assert (statistics.peak > 0) == bool(items)


@given(capacity=st.integers(1, 4), senders=st.integers(1, 4), receivers=st.integers(1, 4), each=st.integers(0, 6))
def test_many_senders_and_receivers_lose_and_double_nothing(capacity, senders, receivers, each):
    async def pass_through():
        channel = Channel(capacity)

        async def send(first):
            for item in range(first, first + each):
                await channel.send(item)

        async def send_all():
            await asyncio.gather(*(send(100 * i) for i in range(senders)))
            await channel.close()

        *taken, _ = await asyncio.gather(*(drain(channel, []) for _ in range(receivers)), send_all())
        return sorted(item for part in taken for item in part)

    assert asyncio.run(pass_through()) == [100 * i + k for i in range(senders) for k in range(each)]


async def test_closing_wakes_the_sender_and_items_can_still_be_taken():
    channel = Channel(1)
    await channel.send(1)
    waiting = asyncio.create_task(channel.send(2))
    await asyncio.sleep(0)
    await channel.close()
    with pytest.raises(ChannelClosed):
        await waiting
    assert await channel.receive() == 1
    with pytest.raises(ChannelClosed):
        await channel.receive()


async def test_a_cancelled_wait_takes_nothing_with_it():
    channel = Channel(1)
    waiting = asyncio.create_task(channel.receive())
    await asyncio.sleep(0)
    waiting.cancel()
    await asyncio.gather(waiting, return_exceptions=True)
    await channel.send(1)
    assert await channel.receive() == 1


def test_a_channel_without_room_is_refused():
    with pytest.raises(ValueError, match="capacity 0"):
        Channel(0)


async def test_a_dropping_channel_returns_the_oldest_and_never_waits():
    channel = Channel(2, "drop_oldest")
    assert [await channel.send(i) for i in range(5)] == [None, None, 0, 1, 2]
    assert channel.statistics().dropped == 3
    assert await channel.receive_all() == [3, 4]
    await channel.close()
    with pytest.raises(ChannelClosed):
        await channel.receive_all()


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


async def test_a_first_or_late_frame_is_due_at_once_and_no_early_one():
    pacer = Pacer(SLOW)
    assert returns_at_once(pacer, 5 * SECOND_NS)
    assert returns_at_once(pacer, 5 * SECOND_NS)
    assert not returns_at_once(pacer, 6 * SECOND_NS)
    hurried = Pacer(1e15)
    assert all(returns_at_once(hurried, i * SECOND_NS) for i in range(1, 100))


async def test_a_jump_back_starts_the_clock_anew():
    pacer = Pacer(SLOW)
    stamps_ns = [9 * SECOND_NS, 10 * SECOND_NS, 2 * SECOND_NS, 3 * SECOND_NS]
    assert [await soon(pacer.wait(stamp_ns)) for stamp_ns in stamps_ns] == [True, False, True, False]


async def answered():
    return "there"


async def failed():
    raise OSError("the disk is full")


async def test_what_ends_by_itself_is_returned_and_its_error_raised():
    stop = StopRequest()
    assert await stop.within_grace(answered(), "job") == "there"
    with pytest.raises(OSError, match="full"):
        await stop.within_grace(failed(), "job")
    assert not stop.is_requested


def test_a_stop_cancels_what_exceeds_the_grace_period():
    was_cancelled = []

    async def never():
        try:
            await asyncio.Event().wait()
        except asyncio.CancelledError:
            was_cancelled.append(True)
            raise

    async def run():
        stop = StopRequest()
        waiting = asyncio.create_task(stop.within_grace(never(), "job", grace_s=0.01))
        await asyncio.sleep(0)
        assert not waiting.done()
        stop.request()
        assert await waiting is None

    asyncio.run(run())
    assert was_cancelled == [True]


async def test_what_comes_within_the_grace_is_taken():
    stop, arrived = StopRequest(), asyncio.Event()

    async def late():
        await arrived.wait()
        return "just in time"

    waiting = asyncio.create_task(stop.within_grace(late(), "job", grace_s=30.0))
    await asyncio.sleep(0)
    stop.request()
    await asyncio.sleep(0)
    arrived.set()
    assert await waiting == "just in time"
