from dataclasses import dataclass, replace
from functools import partial
import numpy as np
import pytest
from hickory_stream.box_scene import SceneSource
from hickory_stream.evaluation.why_text import place_text
from hickory_stream.geometry.camera import Camera
from hickory_stream.inspection.point_history import story_of_point
from hickory_stream.perception.choose import make_segmenter
from hickory_stream.perception.perceive import PerceptionConfig
from hickory_stream.records import ObjectKind
from tests.engine.run_fixtures import NO_SHAPES, map_scene
from tests.perception.perception_scenes import Block, floor, looking, render

CAMERA = Camera(width=240, height=180, fx=190.0, fy=190.0, cx=119.5, cy=89.5)
GREY, WHITE, BROWN, RED = (125, 125, 120), (215, 215, 210), (120, 80, 45), (180, 50, 40)
NUM_FRAMES = 8
# The opening in the wall at x = 3 m, one metre wide and two metres high.
AROUND = (
    Block(low=(3.0, -4.0, 0.0), high=(3.2, -0.5, 2.6), color=WHITE),
    Block(low=(3.0, 0.5, 0.0), high=(3.2, 4.0, 2.6), color=WHITE),
    Block(low=(3.0, -0.5, 2.0), high=(3.2, 0.5, 2.6), color=WHITE),
)
STRUCTURE, EITHER = "taken for structure in 8", "in #1, "
WALL = Block(low=(3.0, -4.0, -0.5), high=(3.2, 4.0, 2.6), color=WHITE)
BOX = Block(low=(1.6, 0.7, 0.0), high=(2.0, 1.1, 0.4), color=RED)


@dataclass(frozen=True, kw_only=True)
class Room:
    """What is in view, with a point and its end: a kind, `EITHER`, or `STRUCTURE`; `glass` returns no depth."""

    things: tuple[Block, ...]
    at: tuple[float, float, float]
    end: str
    look: tuple[float, float, float] = (3.0, 0.0, 0.9)
    glass: Block | None = None


ROOMS = {
    "no floor in view": Room(
        things=(WALL, Block(low=(2.7, -0.4, 1.7), high=(3.0, 0.4, 2.2), color=BROWN)),
        at=(2.7, 0.0, 1.9), end=EITHER, look=(3.0, 0.0, 1.9),
    ),
    "a wall of shelves": Room(
        things=(
            floor(GREY), WALL, BOX,
            *(Block(low=(2.65, -1.9, z), high=(3.0, 1.9, z + 0.03), color=BROWN) for z in np.linspace(0.05, 2.2, 6)),
            *(Block(low=(2.65, y, 0.0), high=(3.0, y + 0.03, 2.23), color=BROWN) for y in np.linspace(-1.9, 1.87, 5)),
        ),
        at=(2.65, 0.0, 0.92), end=EITHER,
    ),
    "a mirror": Room(
        things=(
            floor(GREY), *AROUND, BOX, Block(low=(4.0, -0.2, 0.0), high=(4.4, 0.2, 0.5), color=BROWN),
            Block(low=(5.5, -4.0, 0.0), high=(5.7, 4.0, 2.6), color=WHITE),
        ),
        at=(4.0, 0.0, 0.3), end="in #1, object 0.",
    ),
    "a glass door": Room(
        things=(
            floor(GREY), *AROUND, BOX,
            *(Block(low=(2.95, y, 0.0), high=(3.05, y + 0.08, 2.0), color=BROWN) for y in (-0.5, 0.42)),
        ),
        at=(2.95, -0.46, 1.0), end=STRUCTURE, glass=Block(low=(3.0, -0.42, 0.0), high=(3.02, 0.42, 2.0), color=GREY),
    ),
    "a cupboard in a niche": Room(
        things=(floor(GREY), *AROUND, BOX, Block(low=(3.0, -0.5, 0.02), high=(3.6, 0.5, 2.0), color=BROWN)),
        at=(3.0, 0.0, 1.0), end=STRUCTURE,
    ),
}  # fmt: skip


class RoomSource(SceneSource):
    """A source of a room: a camera that goes sideways before the wall."""

    def __init__(self, room):
        super().__init__(NUM_FRAMES, (), camera=CAMERA)
        self._room = room

    def frames(self):
        for raw in super().frames():
            pose = looking(self._room.look, start=(0.0, -1.4 + 0.4 * raw.index, 1.3))
            yield replace(raw, world_from_camera=pose, decode=partial(self._shown, raw, pose))

    def _shown(self, raw, pose):
        things, glass = list(self._room.things), self._room.glass
        frame, _ = render(things, pose, CAMERA)
        depth_m = frame.depth_m
        if glass is not None:
            _, shown = render([*things, glass], pose, CAMERA)
            depth_m = np.where(shown == len(things), np.float32(np.nan), depth_m)
        return replace(frame, index=raw.index, stamp_ns=raw.stamp_ns, depth_m=depth_m)


@pytest.mark.parametrize("name", ROOMS)
def test_an_odd_room_has_kinds_with_probabilities_and_reasons(tmp_path, name):
    room, segmenter = ROOMS[name], make_segmenter(PerceptionConfig())
    run = map_scene(tmp_path, *NO_SHAPES, source=RoomSource(room), segmenter=segmenter)
    objects = run.snapshots[-1].objects
    assert len(objects) == sum(thing.color == RED for thing in room.things) + room.end.startswith(EITHER)
    assert all(
        0 < item.fixture_probability < 1 and item.kind is ObjectKind.of(item.fixture_probability) for item in objects
    )
    said = place_text(story_of_point(run.folder.path, np.array(room.at)))
    assert room.end in said
    assert ("a fixture by 0." in said) == room.end.startswith(EITHER)
