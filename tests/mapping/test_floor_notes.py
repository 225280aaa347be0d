from dataclasses import dataclass
import numpy as np
import pytest
from numpy.typing import NDArray
from hickory_stream.box_scene import PERIOD_NS, SCENE_BOXES, SCENE_CAMERA, START_NS, SceneBox, cast_scene, scene_pose
from hickory_stream.geometry.rigid import from_rotation_translation
from hickory_stream.geometry.voxels import centers_of_keys, keys_of_points, sorted_unique
from hickory_stream.mapping.config import MappingConfig
from hickory_stream.mapping.core import MapperCore
from hickory_stream.mapping.floor_warnings import floor_warnings, tilt_warning
from hickory_stream.perception.choose import make_segmenter
from hickory_stream.perception.descriptor import ColorTextureDescriptor
from hickory_stream.perception.perceive import PerceptionConfig, features_of, perceive
from hickory_stream.records import Decision, Frame, MapSnapshot, ObservedSpace, Phase, Submap
from tests.perception.perception_scenes import looking
from tools.evaluation.masks.first_layer import answered

VOXEL_M = 0.05


def space_of(points, floor_z_m):
    return ObservedSpace(
        voxel_m=VOXEL_M, free=sorted_unique(keys_of_points(np.array([[0.0, 0.0, 1.0]]), VOXEL_M)),
        structure=sorted_unique(keys_of_points(points, VOXEL_M)), floor_z_m=floor_z_m,
    )  # fmt: skip


def plane(tilt_deg=0.0, uphill_deg=0.0, half_m=2.5):
    x, y = np.meshgrid(np.arange(-half_m, half_m, 0.02), np.arange(-half_m, half_m, 0.02))
    along = x * np.cos(np.radians(uphill_deg)) + y * np.sin(np.radians(uphill_deg))
    return np.stack([x, y, np.tan(np.radians(tilt_deg)) * along], axis=-1).reshape(-1, 3)


def lifted(by_m, half_m=2.5):
    return plane(half_m=half_m) + np.array([0.0, 0.0, by_m])


def wall(x_m):
    y, z = np.meshgrid(np.arange(-2.5, 2.5, 0.02), np.arange(-0.1, 2.4, 0.02))
    return np.stack([np.full(y.shape, x_m), y, z], axis=-1).reshape(-1, 3)


def snapshot(*spaces, world_from_submap=None):
    place = np.eye(4) if world_from_submap is None else world_from_submap
    submaps = tuple(Submap(id=i, world_from_submap=place, observed_space=space) for i, space in enumerate(spaces))
    return MapSnapshot(revision=1, stamp_ns=1, submaps=submaps, objects=())


def test_a_level_floor_between_walls_is_nothing_to_speak_of():
    assert floor_warnings(snapshot(space_of(np.concatenate([plane(), wall(2.4), wall(-2.4)]), 0.0))) == ()


@pytest.mark.parametrize(("tilt_deg", "uphill_deg"), [(1.5, 0.0), (2.0, 90.0), (3.0, -150.0), (5.0, 45.0)])
def test_the_tilt_of_a_floor_is_told_to_a_tenth_of_a_degree(tilt_deg, uphill_deg):
    note = tilt_warning(space_of(np.concatenate([plane(tilt_deg, uphill_deg), wall(2.4)]), 0.0))
    words = note.split()
    assert float(words[words.index("by") + 1]) == pytest.approx(tilt_deg, abs=0.2)
    assert float(words[words.index("towards") + 1]) == pytest.approx(uphill_deg, abs=4.0)


def test_ground_that_rolls_or_has_a_step_has_no_tilt():
    rolling = plane()
    rolling[:, 2] = 0.15 * np.sin(2.5 * rolling[:, 0]) * np.cos(2.0 * rolling[:, 1])
    assert tilt_warning(space_of(rolling, 0.0)) is None
    step = plane()
    step[step[:, 0] > 0, 2] += 0.2
    assert tilt_warning(space_of(step, 0.0)) is None


def test_a_map_without_a_floor_says_so_and_an_empty_one_does_not():
    (note,) = floor_warnings(snapshot(space_of(wall(1.0), None)))
    assert "no floor was seen" in note
    nothing = np.empty(0, dtype=np.int64)
    assert (
        floor_warnings(snapshot(ObservedSpace(voxel_m=VOXEL_M, free=nothing, structure=nothing, floor_z_m=None))) == ()
    )


def test_a_floor_as_small_as_a_table_may_be_one():
    (note,) = floor_warnings(snapshot(space_of(lifted(0.7, half_m=0.5), 0.7)))
    assert "at z = 0.70 m, has an area of 1.0 m2 only and may be a table" in note


def test_floors_of_two_storeys_are_listed_and_a_step_is_not():
    two = snapshot(space_of(plane(), 0.0), space_of(lifted(3.0), 3.0), space_of(lifted(0.2), 0.2))
    (note,) = floor_warnings(two)
    assert "2 levels, at z = 0.00 m, 3.00 m" in note
    assert floor_warnings(snapshot(space_of(plane(), 0.0), space_of(lifted(0.2), 0.2))) == ()


Pose = NDArray[np.float64]

TABLE = SceneBox(low=(-1.2, -1.0, 0.66), high=(1.2, 1.0, 0.72), rgb=(150, 110, 70))
ON_TABLE = (
    SceneBox(low=(-0.35, -0.2, 0.72), high=(-0.15, 0.0, 0.95), rgb=(190, 60, 60)),
    SceneBox(low=(0.2, -0.1, 0.72), high=(0.42, 0.15, 0.88), rgb=(60, 90, 190)),
)
LEG = SceneBox(low=(-0.1, -0.1, 0.0), high=(0.1, 0.1, 0.66), rgb=(90, 70, 50))


@dataclass(frozen=True)
class Played:
    snapshot: MapSnapshot
    decisions: list[Decision]
    midway: list[MapSnapshot]

    def boxes(self):
        found = [o.box.corners_world() for o in self.snapshot.objects if o.phase is not Phase.TENTATIVE]
        return [(corners.min(axis=0), corners.max(axis=0)) for corners in found]

    def has(self, box, world_from_scene=None):
        """Whether an object of the map has the middle of a box, to 8 cm, and no side that is longer by half."""
        pose = np.eye(4) if world_from_scene is None else world_from_scene
        low, high = np.array(box.low), np.array(box.high)
        middle = pose[:3, :3] @ ((low + high) / 2) + pose[:3, 3]
        size = float((high - low).max())
        return any(
            np.abs((a + b) / 2 - middle).max() < 0.08 and (b - a).max() < 1.5 * size + 0.05 for a, b in self.boxes()
        )

    def floor_decisions(self):
        return [decision.text for decision in self.decisions if decision.kind == "floor"]


def played(boxes, poses, told=None, *, is_upside_down=False):
    """Play what a camera sees from `poses`, with the poses that the odometry `told`."""
    config, mapping = PerceptionConfig(segmenter="geometric"), MappingConfig()
    segmenter, extractor, core = make_segmenter(config), ColorTextureDescriptor(), MapperCore(mapping)
    decisions = []
    midway = []
    for i, (pose, said) in enumerate(zip(poses, told or poses, strict=True)):
        rgb, depth_m, _ = cast_scene(boxes, SCENE_CAMERA, pose)
        if is_upside_down:
            rgb, depth_m = np.ascontiguousarray(rgb[::-1, ::-1]), np.ascontiguousarray(depth_m[::-1, ::-1])
        frame = Frame(
            index=i, stamp_ns=START_NS + i * PERIOD_NS, rgb=rgb,
            depth_m=np.where(depth_m < 6.0, depth_m, np.nan).astype(np.float32), camera=SCENE_CAMERA,
            world_from_camera=said,
        )  # fmt: skip
        seen = perceive(frame, core.prior(), None, segmenter, config, lattice=mapping.voxels)

        def features(effect, frame=frame, seen=seen):
            return features_of(effect, seen.observations, extractor.extract(frame.rgb), extractor.patch_px)

        published = answered(core, seen.event(frame), frame.stamp_ns, features)
        decisions += published.decisions
        midway.append(published.snapshot)
    return Played(snapshot=midway[-1], decisions=decisions, midway=midway)


def about(axis, degrees):
    angle = np.radians(degrees)
    rotation = np.eye(3)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    rotation[i, i] = rotation[j, j] = np.cos(angle)
    rotation[j, i], rotation[i, j] = np.sin(angle), -np.sin(angle)
    return from_rotation_translation(rotation, np.zeros(3))


def raised(pose, by_m):
    return from_rotation_translation(np.eye(3), np.array([0.0, 0.0, by_m])) @ pose


def at_height(space, z_m):
    """How many voxels of structure there are at a height."""
    return int((np.abs(centers_of_keys(space.structure, space.voxel_m)[:, 2] - z_m) < 0.05).sum())


CIRCLE = [scene_pose(i) for i in range(14)]
OVER_THE_TABLE = [
    looking((0.0, 0.0, 0.78), start=(0.45 * np.cos(a), 0.45 * np.sin(a), 1.25)) for a in np.linspace(0, 4, 12)
]
AROUND_THE_TABLE = [
    looking((0.0, 0.0, 0.55), start=(2.9 * np.cos(a), 2.9 * np.sin(a), 1.6)) for a in np.linspace(4, 6, 8)
]


@pytest.fixture(scope="module")
def over_the_table():
    return played((TABLE, LEG, *ON_TABLE), OVER_THE_TABLE)


def test_with_only_a_table_in_view_the_map_doubts_its_floor(over_the_table):
    assert all(over_the_table.has(box) for box in ON_TABLE)
    (note,) = floor_warnings(over_the_table.snapshot)
    assert "may be a table" in note
    assert "z = 0.72 m" in note
    assert over_the_table.floor_decisions() == []


def test_a_table_stops_being_the_floor_once_one_is_seen_below():
    found = played((TABLE, LEG, *ON_TABLE), [*OVER_THE_TABLE, *AROUND_THE_TABLE])
    last = len(OVER_THE_TABLE) - 1
    before, soon, after = (found.midway[i].submaps[0].observed_space for i in (last, last + 2, -1))
    assert at_height(before, 0.72) > 100
    assert at_height(soon, 0.72) == 0
    assert before.floor_z_m == pytest.approx(0.72, abs=0.02)
    assert after.floor_z_m == pytest.approx(0.0, abs=0.02)
    (text,) = found.floor_decisions()
    assert "a table or the like" in text
    assert all(found.has(box) for box in ON_TABLE)
    low, high = np.array(TABLE.low), np.array(TABLE.high)
    tables = [(a, b) for a, b in found.boxes() if (b - a)[:2].min() > 1.6]
    assert any(np.abs((a + b)[:2] / 2 - (low + high)[:2] / 2).max() < 0.15 for a, b in tables)
    assert floor_warnings(found.snapshot) == ()


@pytest.mark.parametrize("degrees", [2.0, -2.0])
def test_gravity_two_degrees_off_is_reported_and_objects_stay(degrees):
    tilt = about(0, degrees)
    found = played(SCENE_BOXES, CIRCLE, [tilt @ pose for pose in CIRCLE])
    assert all(found.has(box, tilt) for box in SCENE_BOXES)
    assert len(found.boxes()) == len(SCENE_BOXES)
    (note,) = floor_warnings(found.snapshot)
    assert "tilted by 2.0 degrees" in note


def test_a_camera_that_hangs_upside_down_maps_the_same_objects():
    turn = about(2, 180.0)
    found = played(SCENE_BOXES, CIRCLE, [pose @ turn for pose in CIRCLE], is_upside_down=True)
    assert all(found.has(box) for box in SCENE_BOXES)
    assert len(found.boxes()) == len(SCENE_BOXES)
    assert found.snapshot.submaps[0].observed_space.floor_z_m == pytest.approx(0.0, abs=0.02)
    assert floor_warnings(found.snapshot) == ()
    assert found.floor_decisions() == []


def test_poses_with_z_down_give_the_message_of_no_floor():
    flip = about(0, 180.0)
    (note,) = floor_warnings(played(SCENE_BOXES, CIRCLE, [flip @ pose for pose in CIRCLE]).snapshot)
    assert "no floor was seen" in note
    assert "z upwards" in note


def test_a_log_that_begins_out_of_range_maps_what_comes_later():
    found = played(
        SCENE_BOXES, [*[looking((0.0, 0.0, 8.0), start=(2.0, 0.0, 9.0 - 0.2 * i)) for i in range(4)], *CIRCLE]
    )
    assert floor_warnings(found.midway[3]) == ()
    assert all(found.has(box) for box in SCENE_BOXES)
    assert found.snapshot.submaps[0].observed_space.floor_z_m == pytest.approx(0.0, abs=0.02)


def test_a_lift_gives_a_submap_with_a_floor_for_each_storey():
    ride = [raised(CIRCLE[-1], 0.5 * i) for i in range(1, 6)]
    upstairs = [raised(pose, 3.0) for pose in CIRCLE]
    found = played(SCENE_BOXES, [*CIRCLE, *([CIRCLE[-1]] * 5), *CIRCLE], [*CIRCLE, *ride, *upstairs])
    assert any("another storey" in text for text in found.floor_decisions())
    floors = [submap.observed_space.floor_z_m for submap in found.snapshot.submaps]
    assert floors[0] == pytest.approx(0.0, abs=0.02)
    assert floors[-1] == pytest.approx(3.0, abs=0.02)
    lifted = raised(np.eye(4), 3.0)
    assert all(found.has(box) and found.has(box, lifted) for box in SCENE_BOXES)
    assert any("levels, at z = 0.00 m, 3.00 m" in note for note in floor_warnings(found.snapshot))
