"""Light, weather, steep ground and kerbs: what they do to the masks of a frame, and to a map."""

from dataclasses import replace
import numpy as np
import pytest
from hickory_stream.changes.within_run import changes_within_run
from hickory_stream.config import MapperConfig
from hickory_stream.events import SourceEnded
from hickory_stream.geometry.rigid import from_rotation_translation
from hickory_stream.geometry.voxels import centers_of_keys
from hickory_stream.mapping.core import MapperCore
from hickory_stream.perception.choose import make_segmenter
from hickory_stream.perception.descriptor import ColorTextureDescriptor
from hickory_stream.perception.perceive import features_of, perceive
from hickory_stream.records import Phase
from players.doctor.diagnosis import Diagnosis, judge_conditions
from players.doctor.light_and_rain import conditions_of, median_conditions
from tests.perception.perception_scenes import Block, Cylinder, best_iou, floor, looking, render
from tools.evaluation.masks.first_layer import answered

CONFIG = MapperConfig()
SEGMENTER, EXTRACTOR = make_segmenter(CONFIG.perception), ColorTextureDescriptor()
BOX = Block(low=(0.2, -0.4, 0.0), high=(0.7, 0.2, 0.45), color=(180, 60, 50))
PAVEMENT = Block(low=(1.0, -20.0, -1.0), high=(20.0, 20.0, 0.12), color=(130, 125, 120))
HOUSE = Block(low=(1.6, -9.0, 0.0), high=(1.8, 9.0, 3.0), color=(205, 195, 180))
KIOSK = Block(low=(0.8, 1.5, 0.0), high=(1.4, 2.1, 0.9), color=(200, 190, 60))
# Posts, and bars and spokes of a bicycle.
THIN = [
    *(Cylinder(foot=(x, 0.4 * x, 0.0), radius=0.015, height=1.1, color=(60, 60, 60)) for x in (-0.6, -0.2, 0.4, 1.0)),
    *(Block(low=(-0.8, -0.9, z), high=(-0.78, 0.1, z + 0.02), color=(20, 80, 20)) for z in (0.3, 0.6, 0.9)),
    *(Block(low=(-0.8, y, 0.0), high=(-0.79, y + 0.008, 0.6), color=(20, 80, 20)) for y in np.arange(-0.9, -0.3, 0.1)),
]
STAIRS = [
    Block(low=(0.2 + 0.3 * i, -1.5, 0.0), high=(9.0, 1.5, 0.17 * (i + 1)), color=(140, 135, 130)) for i in range(8)
]


def view(*things, at=(0.6, 0.0, 0.0), start=(-2.4, -0.2, 1.4), noise=0.0015):
    """A frame with noise of depth and colour, and the thing that each of its pixels shows."""
    frame, shown = render([floor(), *things], looking(at, start=start))
    rng = np.random.default_rng(1)
    depth = np.where(frame.depth_m < 10.0, frame.depth_m, np.nan)
    depth = depth + rng.normal(0.0, noise, depth.shape) * depth * depth
    rgb = np.clip(frame.rgb + rng.normal(0.0, 3.0, frame.rgb.shape), 0, 255).astype(np.uint8)
    return replace(frame, rgb=rgb, depth_m=depth.astype(np.float32)), shown


@pytest.mark.parametrize("distance_m", [5.0, 7.0, 9.5])
def test_the_front_of_a_house_is_structure_as_far_as_there_is_depth(distance_m):
    x = distance_m - 2.4
    front = Block(low=(x, -1.0, 0.0), high=(x + 0.2, 1.0, 3.0), color=(205, 195, 180))
    frame, shown = view(front, at=(6.0, 0.0, 1.0), noise=0.0025)
    on_front = (shown == 1) & np.isfinite(frame.depth_m)
    assert SEGMENTER.segment(frame).structure[on_front].mean() > 0.9


def with_hard_shadow(frame):
    y, x = np.indices(frame.depth_m.shape)
    dark = (x + y > 150) & (x + y < 260)
    return replace(frame, rgb=np.where(dark[..., None], frame.rgb * 0.3, frame.rgb).astype(np.uint8))


def in_rain(frame, share=0.03, streak=1):
    rng, depth = np.random.default_rng(2), frame.depth_m.copy()
    for y, x in rng.integers(0, depth.shape, (round(share * depth.size / streak), 2)):
        depth[y : y + streak, x] = rng.uniform(0.4, 3.0)
    return replace(frame, depth_m=depth)


def with_holes(frame):
    missed = np.random.default_rng(2).random(frame.depth_m.shape) < 0.15
    return replace(frame, depth_m=np.where(missed, np.float32(np.nan), frame.depth_m))


def on_ramp(frame, degrees):
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    tilt = from_rotation_translation(np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]), np.zeros(3))
    return replace(frame, world_from_camera=tilt @ frame.world_from_camera)


def maps_of(frames):
    """The maps after keyframes of half a second each, and the finished one."""
    core, maps = MapperCore(CONFIG.mapping), []
    for i, frame in enumerate(frames):
        frame = replace(frame, index=i, stamp_ns=i * 500_000_000)
        seen = perceive(frame, core.prior(), None, SEGMENTER, CONFIG.perception, lattice=CONFIG.mapping.voxels)

        def features(effect, frame=frame, seen=seen):
            return features_of(effect, seen.observations, EXTRACTOR.extract(frame.rgb), EXTRACTOR.patch_px)

        maps.append(answered(core, seen.event(frame), frame.stamp_ns, features).snapshot)
    return [*maps, answered(core, SourceEnded(stamp_ns=frame.stamp_ns), frame.stamp_ns, None).snapshot]


def objects_in(snapshot):
    return [item for item in snapshot.objects if item.phase is not Phase.TENTATIVE]


def car_at(y):
    """A car that stands along y, with two wheels towards the camera."""
    body = Block(low=(-1.0, y - 1.6, 0.2), high=(0.4, y + 1.6, 0.75), color=(60, 80, 170))
    cabin = Block(low=(-0.9, y - 0.9, 0.75), high=(0.3, y + 1.1, 1.3), color=(60, 80, 170))
    at = (y - 1.3, y + 0.7)
    return [body, cabin, *(Block(low=(-1.0, v, 0.0), high=(-0.8, v + 0.6, 0.4), color=(30, 30, 30)) for v in at)]


def person_at(y):
    return [Block(low=(-0.6, y - 0.2, 0.0), high=(-0.3, y + 0.2, 1.6), color=(60, 80, 170))]


def on_the_road(*things_of_frames):
    """Frames across a road, by a camera that sways; each shows a house, a kiosk and some things."""
    return [
        view(HOUSE, KIOSK, *things, at=(0.0, 0.0, 0.5), start=(-3.0, 0.05 * (i % 6) - 0.1, 1.5))[0]
        for i, things in enumerate(things_of_frames)
    ]


def masks_of(frame):
    found = SEGMENTER.segment(frame)
    return found, np.unique(found.instances[found.instances > 0]).size


def with_light(share):
    return lambda frame: replace(frame, rgb=np.clip(frame.rgb * share, 0, 255).astype(np.uint8))


def doctor_names(frames):
    found = Diagnosis(uri="frames")
    judge_conditions(found, median_conditions([conditions_of(frame) for frame in frames]))
    return found.problems + found.notes


@pytest.mark.parametrize(
    ("changed", "named"),
    [(with_light(0.0), "colour is black"), (with_light(2.2), None), (with_hard_shadow, None), (in_rain, "in the air")],
)
def test_light_and_rain_change_no_mask_of_a_thing_and_doctor_names_them(changed, named):
    frame, shown = view(BOX)
    found, count = masks_of(changed(frame))
    assert count == 1
    assert best_iou(found.instances, shown == 1)[0] > 0.9
    assert [named in line for line in doctor_names([changed(frame)])] == [True] * (named is not None)
    assert doctor_names([changed(frame), frame, frame]) == []


@pytest.mark.parametrize(("share", "streak"), [(0.003, 1), (0.01, 5)])
def test_drops_before_thin_things_are_told_thin_things_and_holes_are_not(share, streak):
    frame = with_holes(view(HOUSE, *THIN)[0])
    assert doctor_names([frame]) == []
    assert doctor_names([replace(frame, rgb=frame.rgb[..., :1].repeat(3, axis=-1))])[0].startswith(
        "the camera has no c"
    )
    assert "specks in the air" in doctor_names([in_rain(frame, share, streak)])[0]


@pytest.mark.parametrize("degrees", [-30, -15, 15, 30])
def test_a_thing_on_a_ramp_is_the_only_mask(degrees):
    frame, shown = view(BOX)
    found, count = masks_of(on_ramp(frame, degrees))
    assert count == 1
    assert best_iou(found.instances, shown == 1)[0] > 0.75


def test_stairs_are_one_thing_on_the_floor_before_them():
    frame, shown = view(*STAIRS)
    found, count = masks_of(frame)
    assert count == 1
    assert float((found.instances > 0)[shown > 0].mean()) > 0.8
    assert float(found.structure[shown == 0].mean()) > 0.8


def test_a_camera_carried_up_a_kerb_sees_one_thing():
    steps = [(x, 0.12 if x > 1.0 else 0.0) for x in np.arange(-2.4, 1.4, 0.3)]
    frames = [view(BOX, PAVEMENT, at=(x + 2.5, 0.0, z + 0.2), start=(x, -0.9, z + 1.3))[0] for x, z in steps]
    things = objects_in(maps_of(frames)[-1])
    assert len(things) == 1
    assert things[0].box.center[:2] == pytest.approx((0.45, -0.1), abs=0.15)


def is_kiosk(item):
    return bool(item.box.center[1] > 1.6)


def test_a_parked_car_that_leaves_is_gone_and_the_rest_stays():
    maps = maps_of(on_the_road(*[car_at(0.0)] * 8, *[[]] * 8))
    car = {item.id for item in objects_in(maps[7]) if not is_kiosk(item)}
    gone = {one.object_id for one in changes_within_run(maps[7], maps[-1]) if one.kind == "gone"}
    assert car
    assert gone == car
    assert sum(map(is_kiosk, objects_in(maps[-1]))) == 1


@pytest.mark.parametrize("passer", [car_at, person_at])
def test_what_passes_leaves_no_object(passer):
    passing = [passer(y) for y in np.arange(-4.0, 4.0, 0.9)]
    (left,) = objects_in(maps_of(on_the_road(*[[]] * 4, *passing, *[[]] * 5))[-1])
    assert is_kiosk(left)


def test_a_bush_with_leaves_that_move_is_one_thing_of_its_size():
    rng = np.random.default_rng(3)
    places = rng.uniform((-0.35, -0.35, 0.08), (0.35, 0.35, 0.75), (40, 3))

    def bush():
        moved = places + rng.normal(0.0, 0.02, places.shape)
        return [Block(low=tuple(p - 0.08), high=tuple(p + 0.08), color=(50, 110, 50)) for p in moved]

    maps = maps_of(on_the_road(*(bush() for _ in range(7))))
    (found,) = (item for item in objects_in(maps[-1]) if not is_kiosk(item))
    assert found.box.half_extents_m == pytest.approx((0.42, 0.42, 0.4), abs=0.15)


def test_a_person_who_stood_leaves_no_object_and_no_structure():
    maps = maps_of(on_the_road(*[person_at(0.0)] * 6, *[[]] * 7))

    def structure_of(snapshot):
        space = snapshot.submaps[0].observed_space
        x, y, z = centers_of_keys(space.structure, space.voxel_m).T
        return int(((np.hypot(x + 0.45, y) < 0.4) & (z > 0.2)).sum())

    # Who stands is, from one side, an upright slab from the floor to above one's waist: taken for a piece of wall.
    assert len(objects_in(maps[5])) > 1 or structure_of(maps[5]) > 20
    assert structure_of(maps[-2]) == 0
    (left,) = objects_in(maps[-2])
    assert is_kiosk(left)
