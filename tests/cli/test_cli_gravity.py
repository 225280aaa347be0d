import re
import numpy as np
from scipy.spatial.transform import Rotation
from hickory_stream.box_scene import SCENE_BOXES, SCENE_CAMERA
from hickory_stream.geometry.rigid import from_rotation_translation
from tests.cli.test_cli import answer, ended_as, look, said
from tests.cli.test_cli_strange_walks import log_of
from tests.mapping.test_floor_notes import AROUND_THE_TABLE, CIRCLE, LEG, ON_TABLE, OVER_THE_TABLE, TABLE


def tilted_log(folder, tilt_deg, boxes=SCENE_BOXES, poses=CIRCLE):
    """Write a folder in the layout of TUM whose poses are tilted by so much about x."""
    tilt = from_rotation_translation(Rotation.from_euler("x", tilt_deg, degrees=True).as_matrix(), np.zeros(3))
    return log_of(folder, poses, [tilt @ pose for pose in poses], boxes, camera=SCENE_CAMERA, most_m=5.0)


def test_gravity_off_is_mapped_and_three_commands_say_so(coarse_config, tmp_path):
    folder, out = tilted_log(tmp_path / "log", 2.0), tmp_path / "map"
    ended = ended_as(0, "play", folder, "--out", out, "--config", coarse_config, "--viewer", "none")
    assert "the floor is tilted by 2.0 degrees against gravity" in ended.stderr
    assert ended.stdout.startswith(f"{out}: 3 objects")
    assert answer("inspect", out)["notes"][0].startswith("the floor is tilted by 2.0 degrees")
    assert any(
        "the floor is tilted by 2.0 degrees" in note for note in look("doctor", folder, "--json").json()["notes"]
    )


def test_explain_says_that_what_was_the_floor_is_a_table(coarse_config, tmp_path):
    boxes, poses = (TABLE, LEG, *ON_TABLE), [*OVER_THE_TABLE[::3], *AROUND_THE_TABLE[:2]]
    folder, out = tilted_log(tmp_path / "log", 0.0, boxes, poses), tmp_path / "map"
    said("play", folder, "--out", out, "--config", coarse_config, "--viewer", "none")
    told = said("explain", out, "--point=0.6,0.6,0.72")
    assert re.search(r"frame \d+: a floor is seen at -?0\.0. m: what was taken for it, at 0\.72 m, is a table", told)


def test_doctor_says_of_an_upside_down_log_that_no_floor_shows(tmp_path):
    told = look("doctor", tilted_log(tmp_path / "log", 180.0)).stdout
    assert "shows a floor below the camera" in told
    assert "see whether the poses have z upwards" in told
