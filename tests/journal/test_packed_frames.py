from dataclasses import replace
import numpy as np
import pytest
import zstandard
from hickory_stream.box_scene import SCENE_CAMERA
from hickory_stream.errors import MapFolderError
from hickory_stream.events import FrameObserved
from hickory_stream.geometry.lattice import Lattice
from hickory_stream.journal.packed_frames import PackedFrame, packed_frame, unpacked_frame
from hickory_stream.journal.reader import Journal
from hickory_stream.journal.record_codec import decode, encode
from hickory_stream.journal.step import FramePose, JournalEntry, Step, StepKind
from hickory_stream.journal.writer import JournalWriter
from hickory_stream.perception.coarse import coarse_frame
from hickory_stream.perception.observe import observe
from hickory_stream.records import Frame, Segmentation, SpaceObservation

NO_KEYS = np.empty(0, np.int64)


def seen(*, depth_unit_m=0.001, times=1):
    """Return what is observed of two slanted plates in front of a wall, with noise and holes, from an oblique pose."""
    rng = np.random.default_rng(1)
    camera = SCENE_CAMERA.scaled(times)
    height, width = camera.height, camera.width
    rows, columns = np.mgrid[:height, :width]
    depth = 2.5 + 0.1 * np.sin(columns / 40) + rng.normal(0, 0.003, (height, width))
    instances = np.zeros((height, width), np.int32)
    for label, (top, left, far) in enumerate([(10, 12, 1.2), (40, 60, 1.6)], start=1):
        place = np.s_[top * times : (top + 50) * times, left * times : (left + 60) * times]
        instances[place] = label
        depth[place] = far + 0.002 * (rows[place] / times - top) + rng.normal(0, 0.002, depth[place].shape)
    depth_m = depth.astype(np.float32)
    if depth_unit_m is not None:
        depth_m = np.rint(depth / depth_unit_m).astype(np.float32) * np.float32(depth_unit_m)
    depth_m[rng.random((height, width)) < 0.05] = np.nan
    pose = np.eye(4)
    pose[:3, :3] = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    pose[:3, 3] = (3.0, -2.0, 1.1)
    frame = Frame(
        index=4, stamp_ns=9, rgb=rng.integers(0, 256, (height, width, 3), dtype=np.uint8), depth_m=depth_m,
        camera=camera, world_from_camera=pose,
    )  # fmt: skip
    structure = instances == 0
    segmentation = Segmentation(instances=instances, structure=structure, floor_z_m=None, rejected=())
    observations, _ = observe(frame, segmentation, Lattice())
    assert len(observations) == 2
    return FrameObserved(
        frame_index=4, stamp_ns=9, world_from_camera=pose, observations=observations,
        space=SpaceObservation(free_keys=NO_KEYS, structure_keys=NO_KEYS, floor_z_m=None),
        coarse=coarse_frame(depth_m, structure, camera),
    )  # fmt: skip


def packed(event):
    stored = packed_frame(event)
    assert isinstance(stored, PackedFrame)
    return stored


@pytest.mark.parametrize(("times", "step_px"), [(1, 1), (4, 2)])
def test_an_event_comes_back_to_the_byte_and_takes_less(tmp_path, times, step_px):
    event = seen(times=times)
    assert {one.returns.step_px for one in event.observations} == {step_px}
    stored = encode(packed(event))
    assert encode(unpacked_frame(decode(stored))) == encode(event)
    _written(tmp_path, event)
    with Journal(tmp_path) as journal:
        assert encode(journal.entry(0).events) == encode((event,))
        assert encode(journal.events(0, "FrameObserved")[0]) == encode(event)
    assert len(stored) < 0.6 * len(encode(replace(event, observations=without_returns(event))))


def without_returns(event):
    return tuple(replace(one, returns=None) for one in event.observations)


def test_depth_of_other_units_or_no_camera_is_stored_as_points():
    event = seen(depth_unit_m=None)
    assert all(one.returns is None for one in event.observations)
    assert packed_frame(event) is event
    event = replace(seen(), coarse=None)
    assert encode(packed_frame(event)) == encode(replace(event, observations=without_returns(event)))


def test_a_changed_pose_point_or_mask_makes_points_stored():
    event = seen()
    first, second = event.observations
    pose, mask = event.world_from_camera.copy(), first.mask.copy()
    pose[0, 3] += 0.25
    mask[tuple(np.argwhere(first.returns.depth_mm)[0])] = False
    moved = replace(event, world_from_camera=pose)
    assert encode(packed_frame(moved)) == encode(replace(moved, observations=without_returns(moved)))
    for other in (replace(first, points_world=first.points_world + np.float32(0.25)), replace(first, mask=mask)):
        stored = packed(replace(event, observations=(other, second)))
        assert [part.place for part in stored.packed] == [1]
        expected = replace(event, observations=(replace(other, returns=None), second))
        assert encode(unpacked_frame(decode(encode(stored)))) == encode(expected)


def _changed(data, change):
    return zstandard.compress(change(zstandard.decompress(data)))


def _with_other_depth(depths):
    # The first return takes three bytes.
    return _changed(depths, lambda data: data[:5] + bytes([data[5] ^ 2]) + data[6:])


def _with_bit(marks):
    changed = marks.copy()
    changed[np.flatnonzero(~marks)[0]] = True
    return changed


def test_parts_that_do_not_belong_together_are_refused():
    stored = packed(seen())
    first, second = stored.packed
    for damaged, told in [
        (replace(stored, is_used=_with_bit(stored.is_used)), "returns in"),
        (replace(stored, is_used=stored.is_used[1:]), "marks of"),
        (replace(stored, depths=_changed(stored.depths, lambda data: data[1:])), "returns in"),
        (replace(stored, depths=stored.depths[1:]), "cannot be unpacked|more than"),
        (replace(stored, depths=stored.depths[:-1]), "cannot be unpacked"),
        (replace(stored, depths=zstandard.compress(bytes(1 << 20))), "a frame of more than"),
        (replace(stored, depths=_with_other_depth(stored.depths)), "other points"),
        (replace(stored, colors=_changed(stored.colors, lambda data: data[3:])), "colours of"),
        (replace(stored, colors=_changed(stored.colors, lambda data: data[1:])), "reshape"),
        (replace(stored, colors=_changed(stored.colors, lambda data: data + b"abc")), "colours of"),
        (replace(stored, packed=(first, replace(second, place=2))), "observations .* of 2"),
        (replace(stored, packed=(replace(first, place=-1), second)), "observations .* of 2"),
        (replace(stored, packed=(first, first, second)), "observations .* of 2"),
        (replace(stored, event=_in_image_of(stored.event, 8)), "do not lie in the image"),
        (replace(stored, packed=(replace(first, voxel_m=0.0), second)), "voxels of 0"),
        (replace(stored, packed=(replace(first, step_px=0), second)), "returns of no pixel"),
        (replace(stored, packed=(replace(first, voxel_m=0.02), second)), "other points"),
        (replace(stored, event=replace(stored.event, coarse=None)), "without a camera"),
    ]:
        with pytest.raises(ValueError, match=told):
            unpacked_frame(damaged)


def _in_image_of(event, width):
    return replace(event, coarse=replace(event.coarse, camera=replace(event.coarse.camera, width=width)))


def _written(folder, event):
    pose = FramePose(index=4, stamp_ns=9, world_from_camera=event.world_from_camera)
    step = Step(
        kind=StepKind.KEYFRAME, stamp_ns=9, camera=SCENE_CAMERA, frames=(pose,), round_index=0, first_index=0,
        first_ns=9, num_frames=5, num_keyframes=1, counts={}, shape_counts={},
    )  # fmt: skip
    writer = JournalWriter(folder, flush_s=100.0)
    writer.append(JournalEntry(step=step, events=(event,)))
    writer.close()


def test_damage_of_returns_is_told_as_damage_of_the_journal(tmp_path, monkeypatch):
    stored = packed(seen())
    damaged = replace(stored, depths=_with_other_depth(stored.depths))
    monkeypatch.setattr("hickory_stream.journal.writer.packed_frame", lambda _: damaged)
    _written(tmp_path, stored.event)
    with Journal(tmp_path) as journal, pytest.raises(MapFolderError, match="is damaged or of another version"):
        journal.entry(0)
