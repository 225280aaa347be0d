import shutil
from dataclasses import replace
import numpy as np
import pytest
from hickory_stream.journal.format import JOURNAL
from hickory_stream.journal.reader import Journal
from hickory_stream.journal.step import StepKind
from hickory_stream.journal.writer import JournalWriter
from hickory_stream.map_folder.digest import map_digest
from hickory_stream.map_folder.history.recorded import (
    corrected_trajectory,
    final_snapshot,
    frame_indices,
    recorded_steps,
)
from hickory_stream.map_folder.saved_map import open_map
from tests.engine.run_fixtures import NUM_FRAMES


@pytest.fixture
def path(undisturbed_run):
    return undisturbed_run.folder.path


def rewritten(path, copy, num_steps):
    """A copy of a map whose journal has only the first steps."""
    shutil.copytree(path, copy)
    with Journal(path) as journal:
        writer = JournalWriter(copy, flush_s=0.0)
        for i in range(num_steps):
            writer.append(journal.entry(i))
        writer.close()
    return copy


def moved_map(path):
    """Return another place, and the final map with all its submaps there."""
    final, moved = final_snapshot(path), np.eye(4)
    moved[:3, 3] = (1.0, 2.0, 0.0)
    return moved, replace(final, submaps=tuple(replace(one, world_from_submap=moved) for one in final.submaps))


def steps(path):
    return list(recorded_steps(path, final_snapshot(path)))


def test_every_keyframe_comes_with_what_was_seen_and_decided(path):
    found = steps(path)
    keyframes = [step.keyframe for step in found if step.keyframe is not None]
    assert [k.number for k in keyframes] == list(range(len(keyframes)))
    assert found[-1].keyframe is None
    for step in found:
        if step.keyframe is None:
            continue
        went = {d.observation_index for d in step.decisions if d.observation_index is not None}
        assert went == {o.index for o in step.keyframe.observed.observations}
        assert step.keyframe.observed.coarse.structure.any()
    indices, frames = frame_indices(path)
    assert indices.tolist() == [k.observed.frame_index for k in keyframes]
    assert len(frames) == NUM_FRAMES


def test_a_run_that_was_killed_is_told_as_far_as_it_came(path, tmp_path):
    with Journal(path) as journal:
        count = sum(step.kind is StepKind.KEYFRAME for step in (journal.step(i) for i in range(len(journal))))
    killed = rewritten(path, tmp_path / "killed", count - 1)
    saved = open_map(killed)
    manifest = (killed / "manifest.json").read_text().replace('"finished_cleanly": true', '"finished_cleanly": false')
    (killed / "manifest.json").write_text(manifest)
    assert len(steps(killed)) == count - 1
    assert map_digest(final_snapshot(killed)) != map_digest(saved.snapshot)
    assert (killed / JOURNAL).exists()


def test_a_corrected_submap_is_reported_at_its_final_place(path):
    moved, elsewhere = moved_map(path)
    for step in recorded_steps(path, elsewhere):
        if step.keyframe is not None:
            np.testing.assert_array_equal(step.keyframe.map_from_odometry, moved)
            np.testing.assert_allclose(step.keyframe.odometry_from_map @ moved, np.eye(4), atol=1e-12)


def test_the_trajectory_moves_with_its_submaps(path):
    moved, final = moved_map(path)
    poses, elsewhere = corrected_trajectory(path), corrected_trajectory(path, final)
    assert len(poses) == NUM_FRAMES
    for view in (view for tracked in final.objects for view in tracked.views):
        np.testing.assert_allclose(poses[view.stamp_ns], view.world_from_camera, atol=1e-9)
    assert list(poses) == list(elsewhere) == sorted(poses)
    for stamp_ns, pose in poses.items():
        np.testing.assert_allclose(elsewhere[stamp_ns], moved @ pose, atol=1e-9)
