import asyncio
import pytest
from hickory_stream.engine.async_tools import StopRequest


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
