import numpy as np
import pytest
from rerun.chunk import RrdReader
from hickory_stream.geometry.rigid import invert
from hickory_stream.sinks.rerun.config import RerunConfig
from hickory_stream.sinks.rerun.fleet import FleetRecording, ShownRobot, color_of_robot
from hickory_stream.sinks.rerun.viewer import ViewerChoice, ViewerKind
from tests.alignment.map_fixtures import frame, furniture, snapshot_of
from tests.sinks.test_rerun_arrangement import arrangement_of

ITEMS = furniture(6, 7)
B_FROM_WORLD = frame(70, 2, -1)
NOWHERE = ViewerChoice(kind=ViewerKind.NONE)


def shown(name, count, *, in_frame_of=None, poses=1):
    pose = np.eye(4) if name == "a" else B_FROM_WORLD
    return ShownRobot(
        name=name, stamp_ns=1_000 * count, objects=snapshot_of(ITEMS[:count], pose).objects,
        world_from_camera=np.tile(np.eye(4), (poses, 1, 1)), frame=in_frame_of or name,
        frame_from_robot=np.eye(4) if in_frame_of is None else invert(B_FROM_WORLD),
    )  # fmt: skip


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """Two robots that are joined in the second of two rounds, when b has lost its last object."""
    path = tmp_path_factory.mktemp("fleet") / "fleet.rrd"
    with FleetRecording(path, ["a", "b"], RerunConfig(), NOWHERE) as made:
        made.show(5, [shown("a", 4), shown("b", 4)], [])
        made.show(10, [shown("a", 5), shown("b", 3, in_frame_of="a", poses=2)], ["a and b are joined"])
    return path


@pytest.fixture(scope="module")
def columns(recording):
    found = {}
    for chunk in RrdReader(recording).stream():
        for name, values in chunk.to_record_batch().to_pydict().items():
            found.setdefault(chunk.entity_path, {}).setdefault(name, []).extend(values)
    return found


def test_a_robot_stands_apart_until_it_is_joined(columns):
    apart, joined = (np.ravel(place) for place in columns["/world/b"]["Transform3D:translation"])
    assert columns["/world/b"]["keyframe"] == [5, 10]
    reach_m = max(item.box.corners_world()[:, 0].max() for item in shown("a", 4).objects)
    least_m = min(item.box.corners_world()[:, 0].min() for item in shown("b", 4).objects)
    assert apart[0] + least_m > reach_m
    assert np.allclose(joined, invert(B_FROM_WORLD)[:3, 3], atol=1e-5)


def test_objects_hang_on_their_robot_and_go_when_they_are_gone(columns):
    assert {path for path in columns if path.startswith("/world/a/objects/")} == {
        f"/world/a/objects/{i}" for i in range(1, 6)
    }
    assert "Clear:is_recursive" in columns["/world/b/objects/4"]
    assert columns["/world/b/objects/1"]["keyframe"] == [5], "what looks the same is not logged again"


def test_paths_grow_and_labels_say_who_is_alone(columns):
    assert [len(line[0]) for line in columns["/world/b/path"]["LineStrips3D:strips"]] == [1, 3]
    assert columns["/world/b/robot"]["Points3D:labels"] == [["b, alone"], ["b"]]
    assert columns["/fleet/joins"]["TextLog:text"] == [["a and b are joined"]]
    assert columns["/plots/frames"]["Scalars:scalars"] == [[2.0], [1.0]]
    assert columns["/plots/frames"]["SeriesLines:interpolation_mode"] == [[2]], "a step, no slope"


def test_it_opens_with_the_end_and_with_all_there_was(recording):
    views = arrangement_of(recording)
    for name in ("Robots, a colour each, where they are in the end", "All frames beside one another"):
        assert {"EyeControls3D:position", "EyeControls3D:look_target"} <= views[name]["EyeControls3D"].keys()


def test_robots_of_a_fleet_have_colours_of_their_own():
    assert len({color_of_robot(i) for i in range(24)}) == 24


def test_nothing_is_left_of_the_recording_of_a_fleet_that_failed(tmp_path):
    path = tmp_path / "fleet.rrd"
    with pytest.raises(ValueError, match="no"), FleetRecording(path, ["a"], RerunConfig(), NOWHERE) as made:
        made.show(1, [shown("a", 2)], [])
        raise ValueError("no")
    assert not path.exists()
