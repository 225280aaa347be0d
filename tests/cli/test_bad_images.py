from dataclasses import replace
import cv2
import numpy as np
import pytest
from hickory_stream.box_scene import PERIOD_NS, SCENE_BOXES, SCENE_CAMERA, START_NS, SceneBox, cast_scene, scene_pose
from hickory_stream.geometry.camera import Camera
from hickory_stream.map_folder.saved_map import open_map
from hickory_stream.worlds.zed_log import COLOR_INFO_TOPIC, COLOR_TOPIC, ZedLog
from tests.cli.test_cli import answer, look, refusal

NUM_FRAMES = 10
ROOM = (*SCENE_BOXES, SceneBox(low=(-3.0, -3.2, 0.0), high=(3.0, -3.0, 2.4), rgb=(220, 220, 210)))
BIAS_M = 0.06
NO_SHAPES = "mapper.mapping.requests.max_failures=0"


def black(rgb, depth):
    return np.zeros_like(rgb), depth


def grey(rgb, depth):
    return np.repeat(rgb.mean(axis=2, keepdims=True).astype(np.uint8), 3, axis=2), depth


def fisheye(rgb, depth):
    height, width = depth.shape
    v, u = np.mgrid[:height, :width]
    inside = (u - (width - 1) / 2) ** 2 + (v - (height - 1) / 2) ** 2 < (0.56 * height) ** 2
    return np.where(inside[..., None], rgb, 0).astype(np.uint8), np.where(inside, depth, np.nan).astype(np.float32)


def fisheye_color(rgb, depth):
    return fisheye(rgb, depth)[0], depth


def fisheye_depth(rgb, depth):
    return rgb, fisheye(rgb, depth)[1]


def too_long(rgb, depth):
    return rgb, (depth + BIAS_M).astype(np.float32)


def too_short(rgb, depth):
    return rgb, (depth - BIAS_M).astype(np.float32)


def as_it_is(rgb, depth):
    return rgb, depth


def write_log(path, change=as_it_is, camera=SCENE_CAMERA, *, times=1, colors="three"):
    """Write the scene as a ZED records it, each pair of images changed; 10 frames around three boxes before a wall.

    It is cast with `camera`, each pixel of which then becomes `times` by `times`. `colors`: the channels of its colour
    images; "none" leaves out the images and their calibration.
    """
    cast_with, camera = camera, camera.scaled(times)
    with _Log(path, camera, 90, colors) as log:
        log.write_static(START_NS)
        for i in range(NUM_FRAMES):
            stamp_ns, pose = START_NS + i * PERIOD_NS, scene_pose(i)
            log.write_pose(stamp_ns, pose, np.zeros(6))
            rgb, depth_m, _ = cast_scene(ROOM, cast_with, pose)
            rgb, depth_m = change(rgb, depth_m)
            log.write_images(stamp_ns, *(image.repeat(times, 0).repeat(times, 1) for image in (rgb, depth_m)))
        log.write_pose(START_NS + NUM_FRAMES * PERIOD_NS, scene_pose(NUM_FRAMES), np.zeros(6))
    return path


class _Log(ZedLog):
    """A log whose camera may have one channel, or that may lack its colour."""

    def __init__(self, path, camera, jpeg_quality, colors):
        super().__init__(path, camera, jpeg_quality)
        self._colors = colors

    def _put(self, topic, stamp_ns, message):
        if self._colors == "none" and topic in (COLOR_TOPIC, COLOR_INFO_TOPIC):
            return
        if self._colors == "one" and topic == COLOR_TOPIC:
            light = cv2.imdecode(message.data, cv2.IMREAD_GRAYSCALE)
            data = cv2.imencode(".png", light)[1].ravel()
            message = replace(message, format="mono8; png compressed mono8", data=data)
        super()._put(topic, stamp_ns, message)


def doctor(log):
    return look("doctor", log, "--json").json()


def mapped(log, folder, *overrides):
    """Map a log with the command line; return the centres of the objects' boxes."""
    options = [part for override in (NO_SHAPES, *overrides) for part in ("--set", override)]
    answer("play", log, "--out", folder, "--viewer", "none", *options)
    return [item.box.center for item in open_map(folder).snapshot.objects]


def num_found(centers, within_m):
    """Return how many of the three boxes have an object whose middle is so near theirs."""
    true = [(np.array(box.low) + np.array(box.high)) / 2 for box in SCENE_BOXES]
    return sum(any(np.linalg.norm(center - middle) < within_m for center in centers) for middle in true)


@pytest.mark.parametrize(
    ("change", "least"), [(black, 2), (grey, 3), (fisheye, 2), (fisheye_color, 3), (fisheye_depth, 3)]
)
def test_a_log_with_poor_images_is_mapped(change, least, tmp_path):
    log = write_log(tmp_path / "a.mcap", change)
    assert num_found(mapped(log, tmp_path / "out"), 0.15) >= least
    # A border is no fault, as a lack of colour is.
    assert change in (black, grey) or doctor(log)["problems"] == []


@pytest.mark.parametrize(("width", "height", "times"), [(160, 120, 1), (480, 270, 4)], ids=["160x120", "1920x1080"])
def test_small_and_large_images_are_mapped(width, height, times, tmp_path):
    focal_px = 0.875 * width
    camera = Camera(width=width, height=height, fx=focal_px, fy=focal_px, cx=(width - 1) / 2, cy=(height - 1) / 2)
    log = write_log(tmp_path / "a.mcap", camera=camera, times=times)
    assert num_found(mapped(log, tmp_path / "out"), 0.15) == 3


def test_a_monochrome_camera_is_mapped_and_doctor_names_it(tmp_path):
    log = write_log(tmp_path / "a.mcap", colors="one")
    assert num_found(mapped(log, tmp_path / "out"), 0.15) == 3
    told = doctor(log)
    assert told["problems"] == []
    assert any("the camera has no colour" in note for note in told["notes"])


def test_doctor_says_that_colour_is_black_or_grey(tmp_path):
    told = doctor(write_log(tmp_path / "black.mcap", black))
    assert any("colour is black" in problem for problem in told["problems"])
    told = doctor(write_log(tmp_path / "grey.mcap", grey))
    assert any("the camera has no colour" in note for note in told["notes"])
    told = doctor(write_log(tmp_path / "fine.mcap"))
    assert not any("colour is black" in text for text in told["problems"] + told["notes"])


@pytest.mark.parametrize(("change", "bias_m"), [(too_long, BIAS_M), (too_short, -BIAS_M)])
def test_a_constant_bias_of_depth_is_found_and_taken_off(change, bias_m, tmp_path):
    log = write_log(tmp_path / "a.mcap", change)
    told = doctor(log)
    assert told["frames"]["depth_bias"]["bias_m"] == pytest.approx(bias_m, abs=0.01)
    (problem,) = [text for text in told["problems"] if "at every distance" in text]
    setting = problem.partition("--set ")[2].partition(",")[0]
    name, value = setting.split("=")
    assert name == "mapper.sensor.bias_m"
    assert float(value) == pytest.approx(bias_m, abs=0.01)
    assert num_found(mapped(log, tmp_path / "mended", setting), 0.05) == 3


def test_depth_without_colour_is_refused_with_what_is_missing(tmp_path):
    log = write_log(tmp_path / "a.mcap", colors="none")
    told = refusal("play", log, "--out", tmp_path / "map", "--viewer", "none").splitlines()[-1]
    assert "colour" in told and "--color-topic" in told
