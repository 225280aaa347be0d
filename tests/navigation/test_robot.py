import numpy as np
import pytest
from hickory_stream.errors import ConfigError
from hickory_stream.navigation.robot import Part, grown, load_robot, robot_names, turned

SPHERES = '[[posture]]\nname = "arm"\nspheres_m = [[0.0, 0.0, 0.3, 0.2], [0.3, 0.0, 0.6, 0.1]]\n'


def test_the_robots_that_ship_load_with_their_stated_size():
    heights = {name: [posture.height_m for posture in load_robot(name).postures] for name in robot_names()}
    assert heights == {
        "b2": [0.645, 0.42], "go2": [0.4], "jackal": [0.45, 0.26], "point": [0.2], "spot": [0.61, 0.52],
        "turtlebot3_burger": [0.192], "turtlebot3_waffle": [0.141], "turtlebot4": [0.351],
    }  # fmt: skip
    assert [name for name in robot_names() if load_robot(name).num_headings == 1] == ["point", "turtlebot4"]
    assert load_robot("turtlebot4").reach_m == 0.342 / 2
    assert load_robot("b2").reach_m == pytest.approx(np.hypot(0.549, 0.225))


# Length and width of the makers' data sheets, in metres.
@pytest.mark.parametrize(("name", "size"), [
    ("b2", (1.098, 0.45)), ("go2", (0.7, 0.31)), ("spot", (1.1, 0.5)), ("turtlebot3_burger", (0.138, 0.178)),
    ("turtlebot3_waffle", (0.281, 0.306)),
])  # fmt: skip
def test_the_footprint_of_a_robot_has_the_size_of_its_maker(name, size):
    for posture in load_robot(name).postures:
        assert np.ptp(posture.parts[0].corners_m, axis=0) == pytest.approx(size)


def test_a_robot_of_spheres_is_read_from_a_file(tmp_path):
    path = tmp_path / "arm.toml"
    path.write_text(SPHERES)
    robot = load_robot(str(path))
    assert robot.name == "arm"
    assert robot.postures[0].height_m == pytest.approx(0.7)
    assert robot.reach_m == pytest.approx(0.4)
    assert robot.num_headings > 1


@pytest.mark.parametrize(("text", "complaint"), [
    ("", "misses the key 'posture'"), ("posture = 3", "expected 1 to 8 tables"),
    ('[[posture]]\nname = "a"\nlow_m = 0.1\n', "misses the key 'high_m'"),
    ('[[posture]]\nname = "a"\nlow_m = 0.3\nhigh_m = 0.1\n', "low_m is 0.3; expected at most high_m, 0.1"),
    ('[[posture]]\nname = "a"\nlow_m = 0.1\nhigh_m = nan\n', "high_m is nan; expected 0 to 100 m"),
    ('[[posture]]\nname = "a"\nlow_m = 0.1\nhigh_m = 0.3\nradius = 1\n', "unknown key radius"),
    ('[[posture]]\nname = "a"\nlow_m = 0.1\nhigh_m = 0.3\ncost = 0.5\n', "cost is 0.5; expected 1 to 1000 ratio"),
    ("num_headings = 3\n" + SPHERES, "found num_headings = 3"),
    (SPHERES.replace("0.1]", "inf]"), "inf.*; expected -100 to 100 m"),
    (SPHERES.replace("0.1]", "-0.1]"), "ball_m is -0.1; expected 0 to 1000 m"),
    ('[[posture]]\nname = "a"\nlow_m = -1e9\nhigh_m = 1\n', "low_m is -1000000000.0; expected 0 to 100 m"),
    ('[[posture]]\nname = "a"\nlow_m = 0.1\nhigh_m = 0.3\nradius_m = "1"\n', "radius_m is '1'; expected 0 to"),
    ('num_headings = "8"\n' + SPHERES, "num_headings is '8'; expected 1 to 360 headings"), ("[[posture", "robot"),
])  # fmt: skip
def test_a_file_that_is_no_robot_is_refused_with_the_reason(tmp_path, text, complaint):
    path = tmp_path / "bad.toml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=complaint):
        load_robot(str(path))


def test_an_unknown_robot_is_refused_with_the_known_ones():
    with pytest.raises(ConfigError, match="known are b2, go2, jackal, point"):
        load_robot("rover")
    with pytest.raises(ConfigError, match="cannot read the robot"):
        load_robot("no/such/file.toml")


def test_a_turned_part_covers_its_corners_in_every_heading():
    part = Part(low_m=0.0, high_m=1.0, corners_m=np.array([[0.5, 0.2], [-0.5, 0.2], [-0.5, -0.2], [0.5, -0.2]]))
    covering = turned(part, 0.7, 0.3).corners_m
    directions = np.linspace(0, 2 * np.pi, 90)
    normals = np.stack([np.cos(directions), np.sin(directions)], axis=1)
    for angle in np.linspace(0.55, 0.85, 13):
        c, s = np.cos(angle), np.sin(angle)
        corners = part.corners_m @ np.array([[c, -s], [s, c]]).T
        assert ((normals @ corners.T).max(axis=1) <= (normals @ covering.T).max(axis=1) + 1e-12).all()
    assert grown(part, 0.1).ball_m == pytest.approx(0.1)
