import numpy as np
import pytest
from hickory_stream.errors import ConfigError
from hickory_stream.evaluation.truth import instances_of, load_truth
from hickory_stream.worlds.recording import make_recording
from hickory_stream.worlds.rendering import Renderer
from hickory_stream.worlds.shots import Filming, shots_of
from hickory_stream.worlds.trajectory import WalkConfig
from tools.worlds.building.building import BuildingSize, building
from tools.worlds.building.plan import STOREY_M
from tools.worlds.building.route import building_walk, route_through
from tools.worlds.recording_config import RecordingConfig

SIZE = BuildingSize(floors=2, rooms=4)
FLAT = BuildingSize(floors=1, rooms=2)
SHORT = RecordingConfig(scene="building", seed=3, building=FLAT, seconds=1.0, rate_hz=2.0, width=64, height=48)


@pytest.fixture(scope="module")
def house():
    return building(3, SIZE)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    folder = tmp_path_factory.mktemp("one")
    make_recording(SHORT, folder, "house")
    return folder


def test_every_floor_has_its_rooms_with_things_inside(house):
    assert [len(storey.plan.rooms_m) for storey in house.storeys] == [2, 2]
    assert [item.id for item in house.world.objects] == list(range(1, len(house.world.objects) + 1))
    assert len(house.world.objects) == sum(len(storey.world.objects) for storey in house.storeys) >= 60
    count = len(house.storeys[0].world.objects)
    for i, item in enumerate(house.world.objects):
        floor_m = 0.0 if i < count else STOREY_M
        lower, upper = item.model.bounds_m()
        assert floor_m <= item.world_from_object[2, 3] + lower[2] + 0.003
        assert item.world_from_object[2, 3] + upper[2] < floor_m + 2.6


def test_a_walk_enters_all_rooms_and_returns(house):
    walk = building_walk(house, None, WalkConfig(), 1, np.random.default_rng(1))
    places = walk.world_from_camera[:, :3, 3]
    for storey in house.storeys:
        on_floor = places[np.abs(places[:, 2] - storey.floor_m - WalkConfig().eye_height_m) < 0.1]
        for x0, y0, x1, y1 in storey.plan.rooms_m:
            assert ((on_floor[:, :2] > (x0, y0)) & (on_floor[:, :2] < (x1, y1))).all(axis=1).any()
    assert np.linalg.norm(places[-1] - places[0]) < 0.3
    speeds = np.linalg.norm(np.diff(places, axis=0), axis=1) / np.diff(walk.times_s)
    assert speeds.max() < 1.0
    forward = walk.world_from_camera[:, :3, 2]
    turned = np.degrees(np.arccos(np.clip((forward[:-1] * forward[1:]).sum(axis=1), -1, 1))) / np.diff(walk.times_s)
    assert turned.max() < 80.0


def test_the_stairs_are_beneath_the_walk_and_free(house):
    route = route_through(house, None, 0, np.random.default_rng(1))
    stairs = route.line_m[route.storeys == -1]
    caster = Renderer(house.world)._scene
    eyes = np.add(stairs, (0.0, 0.0, 1.4)).astype(np.float32)
    down = caster.cast(np.hstack([eyes, np.broadcast_to(np.array([0, 0, -1], np.float32), eyes.shape)]))
    # A step's edge is up to its height above or below the slope.
    assert np.abs(down.t - 1.4).max() < 0.25
    ways = np.diff(eyes, axis=0)
    assert not caster.is_occluded(np.hstack([eyes[:-1], ways]).astype(np.float32), 1.0).any()


def test_several_processes_make_the_same_frames_of_buildings(tmp_path):
    filming = Filming(sensors=SHORT.sensors(), stage=SHORT.stage(), caster=None)
    times_s = [0.0, 4.0, 8.0]
    ours, theirs = list(shots_of(filming, times_s)), list(shots_of(filming, times_s, processes=2))
    assert len(ours) == len(theirs) == 3
    for one, other in zip(ours, theirs, strict=True):
        for name in ("rgb", "depth_m", "exact_depth_m", "instances"):
            assert getattr(one, name).tobytes() == getattr(other, name).tobytes(), name
    assert ours[0].rgb.tobytes() != ours[1].rgb.tobytes()
    with pytest.raises(ConfigError, match="2 processes for the scene room; expected 1"):
        make_recording(RecordingConfig(seconds=1.0), tmp_path, "room", processes=2)


def test_the_truth_says_what_each_frame_shows(recorded):
    truth = load_truth(recorded / "house.truth")
    assert len(truth.frames) == 2
    for frame in truth.frames:
        shown = {item.id for item in truth.objects if frame.index in item.frames}
        assert shown == set(np.unique(instances_of(truth, frame)).tolist()) - {0}
        assert frame.world_from_camera[2, 3] == pytest.approx(1.38, abs=0.05)


@pytest.mark.parametrize(("floors", "rooms"), [(0, 10), (9, 40), (3, 5), (2, 41)])
def test_a_size_that_is_no_building_is_refused(floors, rooms):
    with pytest.raises(ConfigError, match=f"{floors} floors and {rooms} rooms; expected 1 to 8 floors"):
        BuildingSize(floors=floors, rooms=rooms)
