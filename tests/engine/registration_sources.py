"""A room that a camera goes around in with an odometry that errs: what tests of registration in runs share."""

from dataclasses import replace
from functools import partial
from hickory_stream.box_scene import SCENE_BOXES, SceneBox, SceneSource
from hickory_stream.geometry.camera import Camera
from hickory_stream.ports import SourceAround
from tests.poses import registration_scenes
from tests.poses.registration_scenes import drifted

NUM_FRAMES = 14
CAMERA = Camera(width=120, height=90, fx=66.0, fy=66.0, cx=59.5, cy=44.5)
ROOM = (
    *SCENE_BOXES,
    *registration_scenes.ROOM[:4],
    SceneBox(low=(-2.9, -2.4, 0.0), high=(-2.1, -1.6, 1.6), rgb=(90, 60, 60)),
)


def room(num_frames=NUM_FRAMES, step_of=int):
    """Return the room with exact poses."""
    return SceneSource(num_frames, ROOM, camera=CAMERA, step_of=step_of)


def drifting(source):
    """Return a source whose odometry goes too far by 4 % and turns by 0.4 degrees too much with every frame."""
    return Unaware(source, drifted([raw.world_from_camera for raw in source.frames()], 0.04, 0.4).__getitem__)


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
