import asyncio
import logging
import threading
from dataclasses import replace
import pytest
from hickory_stream.engine.publisher import SinkThread
from hickory_stream.errors import MapFolderError
from hickory_stream.records import Decision
from hickory_stream.testing import FailingSink, RememberingSink
from tests.sinks.report_fixtures import bare_report

NUM_REPORTS = 60


async def show_all(sink, *, is_essential):
    thread = SinkThread(sink, is_essential=is_essential)
    for i in range(NUM_REPORTS):
        await thread.show(bare_report(i))
    await thread.close()
    return thread


@pytest.mark.parametrize("is_essential", [True, False])
def test_reports_come_in_order_and_then_the_sink_is_closed(is_essential):
    sink = RememberingSink()
    thread = asyncio.run(show_all(sink, is_essential=is_essential))
    assert [shown.index for shown in sink.reports] == list(range(NUM_REPORTS))
    assert sink.is_closed
    assert thread.backlog == 0


def test_a_failing_optional_sink_is_dropped_with_one_warning(caplog):
    sink = FailingSink(3, RuntimeError("the viewer is gone"))
    with caplog.at_level(logging.WARNING):
        asyncio.run(show_all(sink, is_essential=False))
    assert sink.num_shown == 3
    assert [record.message for record in caplog.records] == ["FailingSink failed and is set aside: the viewer is gone"]


@pytest.mark.parametrize("at", [1, 20, NUM_REPORTS])
def test_a_failing_essential_sink_stops_the_run(at):
    sink = FailingSink(at, MapFolderError("cannot write m: the disk is full"))
    with pytest.raises(MapFolderError, match="the disk is full"):
        asyncio.run(show_all(sink, is_essential=True))
    assert sink.num_shown == at


def test_a_sink_that_fails_to_close_counts_as_failing():
    class FailingToClose(RememberingSink):
        def close(self):
            raise MapFolderError("the last save failed")

    asyncio.run(show_all(FailingToClose(), is_essential=False))
    with pytest.raises(MapFolderError, match="the last save failed"):
        asyncio.run(show_all(FailingToClose(), is_essential=True))


@pytest.mark.parametrize("num_reports", [1, 17])
def test_a_hanging_optional_sink_does_not_delay_the_end(num_reports, monkeypatch):
    released = threading.Event()

    class Hanging(RememberingSink):
        def show(self, report):
            released.wait(20)

    async def show_some():
        thread = SinkThread(Hanging(), is_essential=False)
        for i in range(num_reports):
            await thread.show(bare_report(i))
            while i == 0 and thread.backlog:  # noqa: ASYNC110 -- a thread takes it, and tells nobody
                await asyncio.sleep(0)
        await thread.close()

    monkeypatch.setattr("hickory_stream.engine.publisher._CLOSE_TIMEOUT_S", 0.05)
    asyncio.run(show_some())
    released.set()


def test_a_sink_that_failed_is_closed_all_the_same():
    class Failing(RememberingSink):
        def show(self, report):
            raise RuntimeError

    sink = Failing()
    asyncio.run(show_all(sink, is_essential=False))
    assert sink.is_closed


def test_a_slow_sink_misses_frames_between_keyframes_first_and_no_decision():
    released = threading.Event()

    class Slow(RememberingSink):
        def show(self, report):
            released.wait(20)
            super().show(report)

    async def show_all_at_once():
        thread = SinkThread(sink := Slow(), is_essential=False)
        for i in range(NUM_REPORTS):
            told = (Decision(kind="merge", text=f"{i}", object_id=i),)
            report = replace(bare_report(i), keyframe_index=i // 5 if i % 5 == 0 else None, decisions=told)
            await thread.show(report, timeout_s=0.0)
        released.set()
        await thread.show(replace(bare_report(NUM_REPORTS), keyframe_index=12), timeout_s=5.0)
        await thread.close()
        return sink.reports, thread.num_dropped

    reports, num_dropped = asyncio.run(show_all_at_once())
    assert [decision.object_id for report in reports for decision in report.decisions] == list(range(NUM_REPORTS))
    assert num_dropped == NUM_REPORTS + 1 - len(reports) > 0
    shown = [report.index for report in reports]
    assert sum(i % 5 != 0 for i in shown) <= 9
    assert set(range(0, NUM_REPORTS, 5)) - set(shown) <= {50, 55}
