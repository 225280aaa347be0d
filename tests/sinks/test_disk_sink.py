from dataclasses import replace
import numpy as np
import pytest
from hickory_stream.errors import MapFolderError
from hickory_stream.geometry.camera import Camera
from hickory_stream.map_folder.digest import map_digest
from hickory_stream.map_folder.saved_map import open_map
from hickory_stream.map_folder.writer import create_map_folder
from hickory_stream.records import FrameReport
from hickory_stream.sinks.disk_sink import DiskSink, DiskSinkConfig
from tests.engine.snapshot_fixtures import make_snapshot


@pytest.fixture
def folder(tmp_path):
    return create_map_folder(tmp_path / "m", config={}, source={})


def report(index, snapshot):
    return FrameReport(
        index=index, stamp_ns=index, keyframe_index=None if snapshot is None else index,
        camera=Camera(width=4, height=3, fx=4.0, fy=4.0, cx=1.5, cy=1.0), world_from_camera=np.eye(4), color_bytes=None,
        snapshot=snapshot,
    )  # fmt: skip


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
