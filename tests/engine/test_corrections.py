import json
from dataclasses import replace
import numpy as np
import pytest
from hickory_stream.box_scene import SceneSource
from hickory_stream.engine.mapper import Mapper
from hickory_stream.errors import InputError
from hickory_stream.geometry.rigid import apply, from_rotation_translation, yaw_rotation
from hickory_stream.map_folder.digest import map_digest
from hickory_stream.map_folder.history.replay import replay
from hickory_stream.map_folder.saved_map import open_map
from hickory_stream.testing import RememberingSink
from tests.engine.run_fixtures import NO_SHAPES, NUM_FRAMES, map_scene, resume_scene

MOVE = from_rotation_translation(yaw_rotation(0.3), np.array([2.0, 1.0, 0.0]))
SLOW = 2.0


class JumpingSource(SceneSource):
    """The scene, of whose odometry it is said that it jumped before one frame."""

    def frames(self):
        for raw in super().frames():
            yield replace(raw, after_from_before=MOVE) if raw.index == NUM_FRAMES // 2 else raw


def corrected_run(path, places, sink=None, *, name="map"):
    """Map the scene with a jump, correcting poses after some of its snapshots: by their revision."""
    from hickory_stream.sinks.disk_sink import DiskSink

    done = set()

    async def on_snapshot(mapper, snapshot):
        for revision in sorted(places.keys() - done):
            if snapshot.revision >= revision:
                done.add(revision)
                mapper.correct_poses(places[revision])

    def sinks(folder):
        return [(DiskSink(folder), True), *([(sink, True)] if sink is not None else [])]

    return map_scene(
        path, *NO_SHAPES, "journal.checkpoint_keyframes=2", name=name, source=JumpingSource(NUM_FRAMES), sinks=sinks,
        on_snapshot=on_snapshot, rate=SLOW,
    )  # fmt: skip


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    return corrected_run(tmp_path_factory.mktemp("plain"), {})


def test_a_jump_makes_a_second_submap(plain):
    assert [submap.id for submap in plain.snapshots[-1].submaps] == [0, 1]
    assert {item.submap_id for item in plain.snapshots[-1].objects} == {0}


def test_a_correction_moves_the_map_and_its_journal_replays_it(tmp_path, plain):
    sink = RememberingSink()
    moved = corrected_run(tmp_path, {3: {0: MOVE}}, sink)
    saved, before = open_map(moved.folder.path), plain.snapshots[-1]
    for old, new in zip(before.objects, saved.snapshot.objects, strict=True):
        assert np.allclose(new.points_world, apply(MOVE, old.points_world), atol=1e-6)
        assert np.allclose(new.box.world_from_box, MOVE @ old.box.world_from_box)
    # What began after it goes on from what was moved.
    assert [submap.id for submap in saved.snapshot.submaps] == [0, 1]
    assert all(np.array_equal(submap.world_from_submap, MOVE) for submap in saved.snapshot.submaps)
    assert map_digest(saved.snapshot) == moved.digest
    assert map_digest(replay(moved.folder.path)) == moved.digest
    assert not saved.manifest.is_reproducible
    assert saved.ledger["frames"]["pose_corrections"] == 1
    # As known before it, the map lies where the odometry had it.
    first = next(r for r in sink.reports if r.snapshot is not None)
    assert map_digest(saved.as_known_at(first.stamp_ns)) == map_digest(
        open_map(plain.folder.path).as_known_at(first.stamp_ns)
    )
    # The camera is shown where the map has it.
    raw = [frame.world_from_camera for frame in SceneSource(NUM_FRAMES).frames()]
    assert np.array_equal(sink.reports[0].world_from_camera, raw[0])
    assert np.allclose(sink.reports[-1].world_from_camera, MOVE @ raw[-1])


def test_the_identity_restores_the_uncorrected_map(tmp_path, plain):
    run = corrected_run(tmp_path, {2: {0: MOVE}, 5: {0: np.eye(4), 1: np.eye(4)}})
    assert run.digest == plain.digest
    document = json.loads((run.folder.path / "objects.json").read_text())
    assert document == json.loads((plain.folder.path / "objects.json").read_text())


def test_a_correction_after_the_last_frame_is_in_the_map(tmp_path, plain):
    run = corrected_run(tmp_path, {NUM_FRAMES: {0: MOVE}})
    (moved, *_), (old, *_) = run.snapshots[-1].objects, plain.snapshots[-1].objects
    assert np.allclose(moved.box.world_from_box, MOVE @ old.box.world_from_box)
    assert map_digest(replay(run.folder.path)) == run.digest


def test_a_run_that_was_stopped_goes_on_with_its_corrections(tmp_path):
    async def stop(mapper, snapshot):
        if snapshot.revision == 3:
            mapper.correct_poses({0: MOVE})
        if snapshot.revision == 6:
            mapper.stop()

    map_scene(tmp_path, *NO_SHAPES, source=JumpingSource(NUM_FRAMES), on_snapshot=stop, rate=SLOW)

    whole = corrected_run(tmp_path, {3: {0: MOVE}}, name="whole")
    assert resume_scene(tmp_path / "map", JumpingSource(NUM_FRAMES)) == whole.digest
    assert not open_map(tmp_path / "map").manifest.is_reproducible


def test_an_invalid_correction_is_refused_and_the_run_goes_on(tmp_path, plain):
    refused = []

    async def correct(mapper, snapshot):
        if snapshot.revision == 2 and not refused:
            for places in ({9: MOVE}, {0: 2.0 * np.eye(4)}, {0: np.eye(3)}, {0: np.full((4, 4), np.nan)}):
                with pytest.raises(InputError) as error:
                    mapper.correct_poses(places)
                refused.append(str(error.value))

    mappers = []

    async def watch(mapper, snapshot):
        mappers.append(mapper)
        await correct(mapper, snapshot)

    run = map_scene(tmp_path, *NO_SHAPES, source=JumpingSource(NUM_FRAMES), on_snapshot=watch, rate=SLOW)
    with pytest.raises(InputError, match="the map is finished"):
        mappers[0].correct_poses({0: MOVE})
    assert refused[0] == "there is no submap 9: the map has 0 to 0"
    assert all("must be a rigid (4, 4) transform" in text for text in refused[1:])
    assert len(refused) == 4
    assert run.digest == plain.digest
    with pytest.raises(InputError, match="`run` has not begun"):
        Mapper().correct_poses({0: MOVE})
