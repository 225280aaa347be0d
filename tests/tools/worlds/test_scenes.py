import numpy as np
import pytest
from hickory_stream.errors import ConfigError
from hickory_stream.evaluation.truth import instances_of
from hickory_stream.geometry.mesh import is_closed
from hickory_stream.geometry.rigid import is_rigid, rotation_angle_rad
from hickory_stream.worlds.clearance import clearance_of
from hickory_stream.worlds.scene import part_boxes, shared_volume_m3
from hickory_stream.worlds.shots import OCCLUDER_ID
from hickory_stream.worlds.trajectory import Trajectory
from tests.shapes.shape_fixtures import as_mesh
from tools.worlds import big_things, table_things
from tools.worlds.apartment import apartment
from tools.worlds.cache import cached_recording
from tools.worlds.drift import DriftConfig, drifted
from tools.worlds.person import figure
from tools.worlds.recording_config import RecordingConfig, walkable_world
from tools.worlds.routes import joins_rooms
from tools.worlds.tabletop import orbit, tabletop

SEEDS = (2, 5, 77)
KINDS = [
    big_things.armchair, big_things.stool, big_things.bench, big_things.office_chair, big_things.side_table,
    big_things.coffee_table, big_things.nightstand, big_things.dresser, big_things.kitchen_counter, big_things.bed,
    big_things.suitcase, big_things.basket, big_things.speaker, table_things.television, table_things.laptop,
    table_things.kettle, table_things.pot, table_things.pan, table_things.plate_stack, table_things.vase,
    table_things.can, table_things.jar, table_things.carton, table_things.cereal_box, table_things.packet,
    table_things.squeeze_bottle, table_things.ball, table_things.toy_car, table_things.cushion, table_things.table_lamp,
    table_things.clock,
]  # fmt: skip


@pytest.fixture(scope="module")
def apartments():
    return [apartment(seed) for seed in SEEDS]


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: str(kind.__name__))
def test_every_part_of_a_model_is_closed_and_stands_on_its_base(kind):
    model = kind(np.random.default_rng(3))
    assert all(is_closed(as_mesh(part)) for part in model.parts)
    assert model.bounds_m()[0, 2] == pytest.approx(0.0, abs=0.006)


def test_the_walking_figure_has_a_persons_height_in_every_phase():
    for stride in np.linspace(0, 2 * np.pi, 7):
        low, high = figure(float(stride)).bounds_m()
        assert 1.6 < high[2] - low[2] < 1.85


def test_an_apartment_has_25_to_45_objects_of_at_least_20_kinds(apartments):
    for world in apartments:
        assert 25 <= len(world.objects) <= 45
        assert len({item.model.kind for item in world.objects}) >= 20
        assert len(world.rooms_m) == 4
        assert sum(model.kind == "door_way" for model in world.structure) in (3, 4)


def test_a_table_top_has_10_to_20_things_seen_from_every_side():
    for seed in SEEDS:
        table, *things = tabletop(seed).objects
        assert table.model.kind == "table"
        assert 10 <= len(things) <= 20
        top = table.world_from_object[2, 3] + table.model.surfaces[0].center_m[2]
        assert all(item.world_from_object[2, 3] >= top for item in things)
    walk = orbit(tabletop(5), None, 0, np.random.default_rng(1))
    eyes, forward = walk.world_from_camera[:, :3, 3], walk.world_from_camera[:, :3, 2]
    assert (forward[:, 2] < -0.2).all()
    angles = np.unwrap(np.arctan2(eyes[:, 1], eyes[:, 0]))
    assert abs(angles[-1] - angles[0]) > 2 * np.pi


def test_no_two_objects_cut_into_one_another(apartments):
    for world in [*apartments, tabletop(5)]:
        # A ball lies within the box of its basket.
        solid = [item for item in world.objects if item.model.kind != "basket"]
        boxes = [part_boxes(item.model, item.world_from_object) for item in solid]
        for i, one in enumerate(boxes):
            assert all(shared_volume_m3(one, other) == 0.0 for other in boxes[:i])


def test_equal_seeds_make_equal_apartments_and_others_differ():
    def told(world):
        return [(item.model.kind, item.world_from_object.ravel().round(9).tolist()) for item in world.objects]

    assert told(apartment(5)) == told(apartment(5))
    assert told(apartment(5)) != told(apartment(6))
    with pytest.raises(ConfigError, match="expected one of room, apartment, tabletop"):
        RecordingConfig(scene="castle")


def test_one_can_walk_into_every_room_and_the_two_walks_differ(apartments):
    for world in apartments:
        assert joins_rooms(world, 0.3)
    configs = [RecordingConfig(scene="apartment", seed=SEEDS[0], walk_index=i, seconds=None) for i in (0, 1)]
    (world, first), (same_world, second) = (walkable_world(config) for config in configs)
    assert np.array_equal(world.objects[0].world_from_object, same_world.objects[0].world_from_object)
    clearance = clearance_of(world)
    for walk in (first, second):
        assert walk.times_s[-1] >= 60.0
        places = walk.world_from_camera[:, :2, 3]
        assert clearance.at(places).min() > 0.15
        for x0, y0, x1, y1 in world.rooms_m:
            assert ((places > (x0, y0)) & (places < (x1, y1))).all(axis=1).any()
        assert np.linalg.norm(places[-1] - places[0]) < 1.5 or walk.times_s[-1] == pytest.approx(60.0, abs=0.1)
    assert not np.allclose(first.world_from_camera[0], second.world_from_camera[0])


def straight_walk(length_m):
    times = np.linspace(0, 60, 1200)
    poses = np.tile(np.eye(4), (len(times), 1, 1))
    poses[:, 0, 3] = length_m * times / times[-1]
    return Trajectory(times_s=times, world_from_camera=poses)


def test_odometry_starts_true_drifts_and_keeps_gravity():
    walk, config = straight_walk(30.0), DriftConfig()
    ends = []
    for seed in range(20):
        found = drifted(walk, config, np.random.default_rng(seed))
        assert np.array_equal(found.world_from_camera[0], walk.world_from_camera[0])
        assert is_rigid(found.world_from_camera[-1])
        ends.append(float(np.linalg.norm(found.world_from_camera[-1, :3, 3] - walk.world_from_camera[-1, :3, 3])))
    assert 0.05 < float(np.mean(ends)) < 1.5
    exact = drifted(walk, DriftConfig(scale=0.0, yaw_deg_per_m=0.0), np.random.default_rng(0))
    assert exact.world_from_camera == pytest.approx(walk.world_from_camera)
    found = drifted(straight_walk(30.0), DriftConfig(), np.random.default_rng(4)).world_from_camera[-1]
    assert rotation_angle_rad(found[:3, :3]) > 0
    assert found[2, 2] == pytest.approx(1.0)


def test_a_recording_is_made_once_and_does_not_list_the_person(tmp_path):
    small = {"scene": "tabletop", "seed": 5, "width": 96, "height": 72}
    config = RecordingConfig(seconds=8.0, rate_hz=1.0, person=True, drift=DriftConfig(), **small)
    log, truth = cached_recording(config, tmp_path)
    made = log.stat().st_mtime_ns
    again, same = cached_recording(config, tmp_path)
    assert (again, again.stat().st_mtime_ns, len(same.frames)) == (log, made, 8)
    assert all(item.id != OCCLUDER_ID for item in truth.objects)
    shown = np.unique(np.concatenate([instances_of(truth, frame).ravel() for frame in truth.frames]))
    assert set(shown) - {0, OCCLUDER_ID} <= {item.id for item in truth.objects}
    other, _ = cached_recording(RecordingConfig(seconds=1.0, **small), tmp_path)
    assert other != log
