"""A room that a camera goes around in with an odometry that errs: what tests of registration in runs share."""

from dataclasses import replace
from functools import partial
import numpy as np
from hickory_stream.box_scene import SCENE_BOXES, SceneBox, SceneSource
from hickory_stream.geometry.camera import Camera
from hickory_stream.geometry.rigid import compose, from_rotation_translation, invert, yaw_rotation
from hickory_stream.ports import SourceAround

NUM_FRAMES = 14
_GREY = (128, 128, 128)
CAMERA = Camera(width=120, height=90, fx=66.0, fy=66.0, cx=59.5, cy=44.5)
ROOM = (
    *SCENE_BOXES,
    SceneBox(low=(-3.1, -2.6, 0.0), high=(-3.0, 2.6, 2.5), rgb=_GREY),
    SceneBox(low=(3.0, -2.6, 0.0), high=(3.1, 2.6, 2.5), rgb=_GREY),
    SceneBox(low=(-3.1, -2.6, 0.0), high=(3.1, -2.5, 2.5), rgb=_GREY),
    SceneBox(low=(-3.1, 2.5, 0.0), high=(3.1, 2.6, 2.5), rgb=_GREY),
    SceneBox(low=(-2.9, -2.4, 0.0), high=(-2.1, -1.6, 1.6), rgb=(90, 60, 60)),
)


def room(num_frames=NUM_FRAMES, step_of=int):
    """Return the room with exact poses."""
    return SceneSource(num_frames, ROOM, camera=CAMERA, step_of=step_of)


class Drifting(SourceAround):
    """A `Source` whose odometry goes too far by 4 % and turns by 0.4 degrees too much with every frame."""

    def frames(self):
        """Yield the frames, from the true pose of the first."""
        true = None
        pose = np.eye(4)
        for raw in self._source.frames():
            if true is None:
                pose = raw.world_from_camera
            else:
                step = compose(invert(true), raw.world_from_camera)
                step[:3, 3] *= 1.04
                pose = compose(pose, step)
                pose = from_rotation_translation(yaw_rotation(np.radians(0.4)) @ pose[:3, :3], pose[:3, 3])
            true = raw.world_from_camera
            yield replace(raw, world_from_camera=pose, decode=partial(_at, raw, pose))


class Unaware(SourceAround):
    """A `Source` whose odometry says that every frame was taken where `told` has it."""

    def __init__(self, source, told):
        super().__init__(source)
        self._told = told

    def frames(self):
        """Yield the frames."""
        for raw in self._source.frames():
            pose = self._told(raw.index)
            yield replace(raw, world_from_camera=pose, decode=partial(_at, raw, pose))


def _at(raw, pose):
    return replace(raw.decode(), world_from_camera=pose)
