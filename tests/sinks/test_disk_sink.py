import urllib.request
from contextlib import closing
from dataclasses import replace
import pytest
from hickory_stream.errors import InputError, MapFolderError
from hickory_stream.map_folder.digest import map_digest
from hickory_stream.map_folder.saved_map import open_map
from hickory_stream.map_folder.writer import create_map_folder
from hickory_stream.sinks.disk_sink import DiskSink, DiskSinkConfig
from hickory_stream.sinks.metrics_sink import MetricsSink
from tests.engine.snapshot_fixtures import make_snapshot
from tests.sinks.report_fixtures import bare_report


@pytest.fixture
def folder(tmp_path):
    return create_map_folder(tmp_path / "m", config={}, source={})


def report(index, snapshot):
    return bare_report(index, keyframe_index=None if snapshot is None else index, snapshot=snapshot)


def saved_revision(folder):
    return open_map(folder.path).snapshot.revision


def test_the_map_is_saved_every_so_many_keyframes_and_at_the_end(folder):
    sink = DiskSink(folder, DiskSinkConfig(every_keyframes=3))
    snapshot = make_snapshot(folder)
    found = []
    for i in range(1, 9):
        sink.show(report(i, replace(snapshot, revision=i)))
        sink.show(report(i, None))
        found.append(saved_revision(folder))
    sink.close()
    found.append(saved_revision(folder))
    assert found == [0, 0, 3, 3, 3, 6, 6, 6, 8]
    assert map_digest(open_map(folder.path).snapshot) == map_digest(snapshot)


def test_a_run_without_keyframes_leaves_an_empty_map(folder):
    sink = DiskSink(folder)
    sink.show(report(0, None))
    sink.close()
    folder.finish(finished_cleanly=True)
    assert open_map(folder.path).snapshot.objects == ()


def test_a_failed_save_is_an_error_and_repeated_at_the_end(folder):
    sink = DiskSink(folder, DiskSinkConfig(every_keyframes=1))
    snapshot = make_snapshot(folder)
    points = folder.path / "points"
    points.rmdir()
    points.write_text("in the way")
    with pytest.raises(MapFolderError, match=r"cannot write .*points"):
        sink.show(report(1, snapshot))
    assert saved_revision(folder) == 0
    points.unlink()
    points.mkdir()
    sink.close()
    assert saved_revision(folder) == snapshot.revision


REPORT = bare_report(
    metrics=(("time/perceive", 0.25), ("queue/shapes", 3.0), ("engine/workers", 2.0), ("score/7", 0.5))
)


def read(sink):
    with urllib.request.urlopen(f"http://127.0.0.1:{sink.port}/metrics", timeout=10) as answer:
        lines = answer.read().decode().splitlines()
    return {name: float(value) for name, _, value in (line.rpartition(" ") for line in lines if line[0] != "#")}


def test_the_numbers_of_the_newest_report_are_answered_as_text():
    with closing(MetricsSink(0)) as sink:
        sink.show(REPORT)
        sink.show(replace(REPORT, metrics=(("queue/shapes", 1.0),)))
        numbers = read(sink)
    assert numbers["hickory_frames_total"] == 2
    assert numbers["hickory_keyframes_total"] == 0
    assert numbers['hickory_stage_seconds{stage="perceive"}'] == 0.25
    assert numbers['hickory_queue_length{queue="shapes"}'] == 1
    assert numbers['hickory_engine{what="workers"}'] == 2
    assert not any("score" in name for name in numbers)


def test_topics_of_a_live_route_are_answered_on_request():
    topic = {
        "topic": "/cam/image", "role": "color", "rate_hz": 30.0, "age_s": None, "bytes_per_s": 100, "received": 7,
        "dropped": 2, "lost": 1,
    }  # fmt: skip
    with closing(MetricsSink(0)) as sink:
        sink.watch(lambda: [topic])
        topic["received"] = 8
        numbers = read(sink)
    assert numbers['hickory_live_topic{topic="/cam/image",what="rate_hz"}'] == 30
    assert numbers['hickory_live_topic{topic="/cam/image",what="received"}'] == 8
    assert not any("age_s" in name for name in numbers)


def test_a_port_that_is_taken_is_refused():
    with closing(MetricsSink(0)) as sink, pytest.raises(InputError, match="--metrics-port"):
        MetricsSink(sink.port)
