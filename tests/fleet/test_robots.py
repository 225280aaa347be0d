import pytest
from hickory_stream.errors import ConfigError
from hickory_stream.fleet.robots import read_fleet, robots_of

TWO = '[[robot]]\nname = "a"\nlog = "a.mcap"\n[[robot]]\nname = "b"\nlog = "b.mcap"\n'


def file(folder, text):
    path = folder / "fleet.toml"
    path.write_text(text)
    return path


def test_robots_are_read_in_order_with_paths_beside_the_file(tmp_path):
    text = "every_keyframes = 7\n[joining]\nmax_log10_chance = -9\n"
    text += '[[robot]]\nname = "b"\nlog = ["b.bag", "b_vio.bag"]\nprofile = "kimera_multi"\n'
    text += '[[robot]]\nname = "a"\nlog = "zenoh://a.local"\npose_file = "a.tum"\n'
    (b, a), config = read_fleet(file(tmp_path, text))
    assert (b.name, b.uris) == ("b", (str(tmp_path / "b.bag"), str(tmp_path / "b_vio.bag")))
    assert (b.options.profile, b.is_live) == ("kimera_multi", False)
    assert (a.name, a.uris, a.is_live) == ("a", ("zenoh://a.local",), True)
    assert a.options.pose_file == tmp_path / "a.tum"
    assert (config.every_keyframes, config.processes) == (7, 0)
    assert config.joining.max_log10_chance == -9


@pytest.mark.parametrize(("text", "said"), [
    (TWO.replace('"b"', '"a"'), "two robots are called a .*a.mcap and .*b.mcap"),
    (TWO.replace('"b"', '"A"'), "two robots are called A"),
    (TWO.replace('"b"', '"fleet"'), "found the robot name 'fleet'"),
    (TWO.replace('"b"', '"../b"'), r"found the robot name '\.\./b'"),
    (TWO.replace("name =", "nam =", 1), "robot 1 has no name"),
    (TWO.replace("log =", "logs =", 1), "robot a: found log = None"),
    (TWO + 'profil = "zed"\n', "unknown configuration key robot b.profil; did you mean robot b.profile"),
    (TWO + "clock = 3\n", "robot b.clock is 3; expected one of 'auto'"),
    ("every = 3\n" + TWO, r"unknown key every; known keys: every_keyframes.*\[\[robot\]\]"),
    ("every_keyframes = 0\n" + TWO, "every_keyframes"),
    ('[robots.a]\nlog = "a.mcap"\n', "unknown key robots"),
    ('[robot]\nname = "a"\n', r"expected a table \[\[robot\]\]"),
    ('[[robot]]\nname = "a"\nlog = "a.mcap"\n', "expected 2 to 64 robots, found 1"),
    ("a =", "is not TOML"),
])  # fmt: skip
def test_what_cannot_be_is_said_in_one_line_with_the_file(tmp_path, text, said):
    with pytest.raises(ConfigError, match=said) as refused:
        read_fleet(file(tmp_path, text))
    assert str(refused.value).startswith(f"{tmp_path / 'fleet.toml'}")
    assert "\n" not in str(refused.value).strip()
    with pytest.raises(ConfigError, match="cannot read the fleet"):
        read_fleet(tmp_path / "none.toml")


def test_robots_are_named_on_the_command_line():
    named = [(robot.name, robot.uris) for robot in robots_of(["a=x=1.mcap", "b=y.mcap"])]
    assert named == [("a", ("x=1.mcap",)), ("b", ("y.mcap",))]


@pytest.mark.parametrize(("texts", "said"), [
    (["a.mcap", "b=b.mcap"], "found --robot a.mcap, expected NAME=LOG"),
    (["a=a.mcap", "a=b.mcap"], "two robots are called a"),
    (["a=a.mcap"], "expected 2 to 64 robots, found 1"),
])  # fmt: skip
def test_a_command_line_that_names_no_fleet_is_refused(texts, said):
    with pytest.raises(ConfigError, match=said):
        robots_of(texts)
