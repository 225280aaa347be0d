import dataclasses
from itertools import combinations
import numpy as np
import pytest
from hickory_stream.errors import ConfigError
from hickory_stream.evaluation.truth import instances_of
from hickory_stream.geometry.camera import backproject
from hickory_stream.geometry.mesh import is_closed, volume_m3
from hickory_stream.geometry.rigid import apply
from hickory_stream.pictures.ray_caster import ray_caster
from hickory_stream.worlds.clearance import clearance_among
from hickory_stream.worlds.depth_camera import DepthCameraConfig, sensed_depth
from hickory_stream.worlds.object_models import model_triangles
from hickory_stream.worlds.scene import part_boxes
from hickory_stream.worlds.trajectory import WalkConfig
from tests.shapes.shape_fixtures import as_mesh
from tools.worlds.cache import cached_recording, recording_name
from tools.worlds.clutter.contents import CONTENTS
from tools.worlds.clutter.floorplan import OUTLINES
from tools.worlds.clutter.frames import ColorCameraConfig, frames_of
from tools.worlds.clutter.groups import GROUPS
from tools.worlds.clutter.heaps import heap
from tools.worlds.clutter.kit import FAMILIES, SHAPES, TABLE, Recipes, any_material
from tools.worlds.clutter.objects.cloths import curtain, hung_cloth, tablecloth
from tools.worlds.clutter.objects.materials import MATERIALS
from tools.worlds.clutter.room import clutter_room
from tools.worlds.clutter.walk import wander
from tools.worlds.drift import DriftConfig
from tools.worlds.recording_config import RecordingConfig

SHAPE_FIELDS = ("small", "supports", "seats", "bodies", "units")


def names_of(recipes):
    fields = [field.name for field in dataclasses.fields(recipes) if field.name != "flat"]
    return [name for field in fields for name in getattr(recipes, field)]


def test_every_recipe_belongs_to_one_family_and_has_a_name():
    for one, other in combinations(FAMILIES, 2):
        assert set(names_of(TABLE[one])) & set(names_of(TABLE[other])) == set()
    for family in FAMILIES:
        names = names_of(TABLE[family])
        assert len(names) == len(set(names))
        assert set(TABLE[family].flat) <= set(TABLE[family].small)
    told = {f.name: {n for r in TABLE.values() for n in getattr(r, f.name)} for f in dataclasses.fields(Recipes)}
    assert set().union(*(told[field] for field in SHAPE_FIELDS)) == set(SHAPES)
    assert told["materials"] == set(MATERIALS)
    assert told["contents"] == set(CONTENTS)
    assert told["groups"] == set(GROUPS)
    assert told["outlines"] == set(OUTLINES)


@pytest.mark.parametrize("name", sorted(SHAPES))
def test_every_shape_is_closed_solids_on_its_base(name):
    for seed in range(3):
        rng = np.random.default_rng(seed)
        model = SHAPES[name](rng, lambda own: any_material(own, TABLE["training"]))
        for part in model.parts:
            assert is_closed(as_mesh(part)) and volume_m3(as_mesh(part)) > 0
        assert model.bounds_m()[0, 2] == pytest.approx(0.0, abs=1e-6)
        assert 0.03 < np.ptp(model.bounds_m(), axis=0).max() < 3.2


@pytest.fixture(scope="module")
def frames():
    return list(frames_of(3, "training", 3, width=96, height=72))


def test_equal_seeds_give_equal_frames_and_prefixes(frames):
    for one, other in zip(frames, list(frames_of(3, "training", 2, width=96, height=72)), strict=False):
        for name in ("rgb", "depth_m", "instances", "is_structure", "world_from_camera"):
            assert np.array_equal(getattr(one, name), getattr(other, name), equal_nan=name == "depth_m")


def test_families_and_seeds_give_different_rooms_if_known():
    outlines = [
        clutter_room(seed, family, 0).plan.outline_m.tolist()
        for seed, family in ((3, "training"), (4, "training"), (3, "tuning"))
    ]
    assert all(one != other for one, other in combinations(outlines, 2))
    with pytest.raises(ConfigError, match="training, tuning"):
        next(frames_of(1, "test", 1))


def test_a_pixel_is_thing_or_structure_and_sensed_with_noise(frames):
    for frame in frames:
        assert not (frame.is_structure & (frame.instances > 0)).any()
        assert (frame.instances > 0).any()
        is_hit = np.isfinite(frame.exact_depth_m)
        assert np.array_equal(is_hit, frame.is_structure | (frame.instances > 0))
        points = apply(frame.world_from_camera, backproject(frame.exact_depth_m, frame.camera)[is_hit].astype(float))
        assert points[:, 2].min() > -0.01
        assert 0.29 < frame.world_from_camera[2, 3] < 1.81
        both = np.isfinite(frame.depth_m) & np.isfinite(frame.exact_depth_m)
        error = np.abs(frame.depth_m - frame.exact_depth_m)[both]
        assert both.mean() > 0.3
        assert 0 < np.median(error / frame.exact_depth_m[both]) < 0.03


def test_a_log_of_a_random_room_shows_what_its_truth_says(tmp_path):
    config = RecordingConfig(
        scene="clutter", seed=7, seconds=1.0, rate_hz=2.0, width=96, height=72, walk=WalkConfig(clearance_m=0.22)
    )
    log, truth = cached_recording(config, tmp_path)
    assert log.is_file()
    assert cached_recording(config, tmp_path)[0] == log
    assert [frame.index for frame in truth.frames] == [0, 1]
    shown = {int(i) for frame in truth.frames for i in np.unique(instances_of(truth, frame)) if i}
    assert shown == {item.id for item in truth.objects if item.frames}
    assert shown
    assert all(1.3 < frame.world_from_camera[2, 3] < 1.5 for frame in truth.frames)


def test_a_walk_keeps_its_distance_from_everything():
    room = next(room for i in range(20) if len((room := clutter_room(2, "training", i)).world.objects) >= 6)
    walk = wander(room, 20.0, WalkConfig(clearance_m=0.22), np.random.default_rng(0))
    boxes = [box for item in room.world.objects for box in part_boxes(item.model, item.world_from_object)]
    clearance = clearance_among(boxes, room.plan.bounds_m, room.plan.outline_m)
    assert clearance.at(walk.world_from_camera[::30, :2, 3]).min() > 0.1


def test_recordings_keep_the_names_from_before_families():
    assert recording_name(RecordingConfig()) == "room-7-walk0-5cedfbc5c1"
    drifting = RecordingConfig(scene="apartment", seed=3, drift=DriftConfig())
    assert recording_name(drifting) == "apartment-3-walk0-a6543e6655"
    one, other = (recording_name(RecordingConfig(scene="clutter", family=family)) for family in ("training", "tuning"))
    assert one != other


@pytest.mark.parametrize("seed", range(4))
def test_cloth_is_a_closed_sheet(seed):
    rng = np.random.default_rng(seed)
    grey = MATERIALS["uniform_paint"](rng)
    cloths = tablecloth(rng, (0.4, 0.6), 0.2, grey), hung_cloth(rng, 0.5, (0.6, 0.3), grey)
    for part in (part for cloth in (*cloths, curtain(rng, (0.8, 1.9), grey)) for part in cloth.parts):
        assert is_closed(as_mesh(part)) and volume_m3(as_mesh(part)) > 0


@pytest.mark.parametrize("family", FAMILIES)
def test_nothing_stands_within_another_thing(family):
    world = clutter_room(5, family, 1).world
    assert len(world.objects) > 5
    caster, tops = ray_caster(), []
    for item in world.objects:
        vertices, faces = model_triangles(item.model)
        placed = apply(item.world_from_object, vertices.astype(np.float64)).astype(np.float32)
        caster.add(placed, faces)
        tops.append(placed[np.argsort(placed[:, 2])[:200]])
    for i, lowest in enumerate(tops):
        down = np.broadcast_to(np.array([0, 0, -1], dtype=np.float32), lowest.shape)
        hit = caster.cast(np.concatenate([lowest - np.float32([0, 0, 1e-4]), down], axis=1))
        other = np.isfinite(hit.t) & (hit.geometry != i)
        # Going down from within another thing one would leave it through a face that looks down.
        assert (hit.normals[other, 2] < -0.2).sum() < 0.2 * len(lowest)


def test_a_thing_comes_to_rest_on_the_heap_below_it():
    rng = np.random.default_rng(1)
    placed = heap(rng, [SHAPES["carton"](rng, MATERIALS["cardboard"])] * 6, (0.1, 0.1))
    lows = [float(min((p.vertices @ pose[2, :3]).min() for p in m.parts)) + float(pose[2, 3]) for m, pose in placed]
    assert lows[0] == pytest.approx(0.0005, abs=0.004)
    assert all(low > -0.004 for low in lows)
    assert max(lows) > 0.02


def test_glass_gives_no_depth_and_only_a_shift_moves_colour():
    exact = np.full((40, 40), 2.0, dtype=np.float32)
    is_blind = np.zeros((40, 40), dtype=bool)
    is_blind[10:30, 10:30] = True
    facing = np.ones((40, 40), dtype=np.float32)
    config = DepthCameraConfig(dropout_share=0.0)
    sensed = sensed_depth(exact, facing, 200.0, config, np.random.default_rng(0), is_blind)
    assert np.isnan(sensed[is_blind]).all()
    assert np.isfinite(sensed[~is_blind]).mean() > 0.9
    rgb = np.random.default_rng(0).integers(0, 255, size=(30, 40, 3)).astype(np.uint8)
    plain = ColorCameraConfig().photographed(rgb, np.random.default_rng(0))
    moved = ColorCameraConfig(shift_px=(3.0, 0.0)).photographed(rgb, np.random.default_rng(0))
    assert np.array_equal(plain, rgb)
    assert np.array_equal(moved[:, :-3], rgb[:, 3:])
