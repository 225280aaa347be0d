"""Light, weather, steep ground and kerbs: what they do to the masks of a frame, and to a map."""

from dataclasses import replace
import numpy as np
import pytest
from hickory_stream.config import MapperConfig
from hickory_stream.events import FeaturesReady, SourceEnded
from hickory_stream.geometry.rigid import from_rotation_translation
from hickory_stream.mapping.core import MapperCore
from hickory_stream.perception.choose import make_segmenter
from hickory_stream.perception.descriptor import ColorTextureDescriptor
from hickory_stream.perception.perceive import features_of, perceive
from tests.perception.perception_scenes import Block, best_iou, floor, looking, render
from tools.evaluation.masks.first_layer import answered

CONFIG = MapperConfig()
SEGMENTER, EXTRACTOR = make_segmenter(CONFIG.perception), ColorTextureDescriptor()
BOX = Block(low=(0.2, -0.4, 0.0), high=(0.7, 0.2, 0.45), color=(180, 60, 50))
PAVEMENT = Block(low=(1.0, -20.0, -1.0), high=(20.0, 20.0, 0.12), color=(130, 125, 120))
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


def in_night(frame):
    return replace(frame, rgb=np.zeros_like(frame.rgb))


def over_exposed(frame):
    return replace(frame, rgb=np.clip(frame.rgb * 2.2, 0, 255).astype(np.uint8))


def with_hard_shadow(frame):
    y, x = np.indices(frame.depth_m.shape)
    dark = (x + y > 150) & (x + y < 260)
    return replace(frame, rgb=np.where(dark[..., None], frame.rgb * 0.3, frame.rgb).astype(np.uint8))


def in_rain(frame):
    rng = np.random.default_rng(2)
    wrong = rng.random(frame.depth_m.shape) < 0.03
    near = rng.uniform(0.4, 3.0, frame.depth_m.shape).astype(np.float32)
    return replace(frame, depth_m=np.where(wrong, near, frame.depth_m))


def on_ramp(frame, degrees):
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    tilt = from_rotation_translation(np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]), np.zeros(3))
    return replace(frame, world_from_camera=tilt @ frame.world_from_camera)


def mapped(frames):
    """The confirmed objects after keyframes of half a second each."""
    core = MapperCore(CONFIG.mapping)
    for i, frame in enumerate(frames):
        frame = replace(frame, index=i, stamp_ns=i * 500_000_000)
        seen = perceive(frame, core.prior(), None, SEGMENTER, CONFIG.perception, lattice=CONFIG.mapping.voxels)

        def features(effect, frame=frame, seen=seen):
            found, _ = features_of(frame, seen.observations, effect.observation_indices, EXTRACTOR)
            return FeaturesReady(frame_index=effect.frame_index, features=found)

        answered(core, seen.event(frame), frame.stamp_ns, features)
    return answered(core, SourceEnded(stamp_ns=frame.stamp_ns), frame.stamp_ns, None).snapshot.objects


def masks_of(frame):
    found = SEGMENTER.segment(frame)
    return found, np.unique(found.instances[found.instances > 0]).size


@pytest.mark.parametrize("light", [in_night, over_exposed, with_hard_shadow, in_rain])
def test_light_and_rain_change_no_mask_of_a_thing(light):
    frame, shown = view(BOX)
    found, count = masks_of(light(frame))
    assert count == 1
    assert best_iou(found.instances, shown == 1)[0] > 0.9


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


def test_a_frame_without_returns_has_no_floor_and_no_masks():
    frame, _ = view(BOX)
    found, count = masks_of(replace(frame, depth_m=np.full_like(frame.depth_m, np.nan)))
    assert (count, found.floor_z_m) == (0, None)


def test_a_camera_carried_up_a_kerb_sees_one_thing():
    steps = [(x, 0.12 if x > 1.0 else 0.0) for x in np.arange(-2.4, 1.4, 0.3)]
    frames = [view(BOX, PAVEMENT, at=(x + 2.5, 0.0, z + 0.2), start=(x, -0.9, z + 1.3))[0] for x, z in steps]
    things = mapped(frames)
    assert len(things) == 1
    assert things[0].box.center[:2] == pytest.approx((0.45, -0.1), abs=0.15)
