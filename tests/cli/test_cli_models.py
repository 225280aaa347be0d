import re
import cv2
import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper
from tests.cli.test_cli import answer, ended_as, look, refusal, said
from tests.perception import small_graphs


def two_boxes(path):
    """A FastSAM of two boxes, whatever it sees: (1, 4 + 1 + 1, 2) and one prototype of ones."""
    predictions = np.array([[(20, 32, 12, 12, 0.9, 1), (44, 32, 14, 14, 0.8, 1)]], np.float32).transpose(0, 2, 1)
    constants = {"predictions_": predictions, "prototypes_": np.ones((1, 1, 16, 16), np.float32)}
    nodes = [
        helper.make_node("ReduceMin", ["image"], ["least"], keepdims=0),
        helper.make_node("Sub", ["least", "least"], ["nothing"]),
        helper.make_node("Add", ["predictions_", "nothing"], ["predictions"]),
        helper.make_node("Add", ["prototypes_", "nothing"], ["prototypes"]),
    ]
    outputs = [helper.make_tensor_value_info(n[:-1], TensorProto.FLOAT, a.shape) for n, a in constants.items()]
    image = helper.make_tensor_value_info("image", TensorProto.FLOAT, (1, 3, 64, 64))
    made = [numpy_helper.from_array(value, name) for name, value in constants.items()]
    graph = helper.make_graph(nodes, "two boxes", [image], outputs, made)
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=10), str(path))
    return path


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("HICKORY_MODELS", str(tmp_path / "models"))
    return tmp_path / "models"


@pytest.fixture
def fastsam(tmp_path, folder):
    file = two_boxes(tmp_path / "own.onnx")
    said("models", "add", file, "--kind", "fastsam", "--name", "fastsam-s", "--licence", "CC0-1.0")
    return folder / "fastsam-s.onnx"


def test_a_model_is_added_listed_and_found(fastsam, folder):
    assert said("models", "where").strip() == str(folder)
    (model,) = answer("models", "list")["models"]
    assert (model["name"], model["state"], model["input_px"]) == ("fastsam-s", "ok", [64, 64])
    fastsam.write_bytes(b"x")
    assert "sha256" in said("models", "list")


def test_a_check_runs_the_model_on_a_picture_and_draws_it(fastsam, tmp_path):
    told = answer("models", "check", "fastsam-s", "-o", tmp_path / "a.png")
    assert (told["masks"], told["provider"]) == (2, "cpu")
    assert told["run_ms"] >= 0
    assert cv2.imread(str(tmp_path / "a.png")).shape == (400, 600, 3)


def test_nothing_is_fetched_before_size_and_licence_are_agreed(folder):
    told = refusal("models", "get", "fastsam-s")
    assert re.search(r"24 MB from https://.*\n.*FastSAM-s.pt \(23.9 MB\)\n.*AGPL-3.0 \(ultralytics\)", told)
    assert re.search(r"install the extra: pip install|agree with --yes", told)
    assert not folder.exists()


def test_what_is_missing_or_broken_is_refused_in_a_sentence(folder, demo_log, tmp_path):
    half, own = tmp_path / "half.pt", tmp_path / "half.onnx"
    half.write_bytes(b"not weights")
    own.write_bytes(b"not a graph")
    play = ("play", demo_log, "--out", tmp_path / "map", "--viewer", "none")
    for command, told in (
        (("models", "check", "dinov2-small"), "hickory-stream models add dinov2-small.onnx --kind dinov2"),
        (("models", "add", own, "--kind", "dinov2"), "no whole ONNX file (11 bytes)"),
        (("models", "add", half, "--kind", "semantic"), "only fastsam, dinov2, oneformer can be exported"),
        ((*play, "--set", "mapper.perception.segmenter=fastsam"), f"no model fastsam-s in {folder}"),
    ):
        assert told in refusal(*command)
    assert not folder.exists()


def frame_files(tmp_path, depth_shape=(60, 80), color_shape=(60, 80, 3)):
    rng = np.random.default_rng(1)
    cv2.imwrite(str(tmp_path / "c.png"), rng.integers(0, 255, color_shape, np.uint8))
    cv2.imwrite(str(tmp_path / "d.png"), np.full(depth_shape, 1500, np.uint16))
    return tmp_path / "c.png", tmp_path / "d.png"


@pytest.mark.parametrize("color_shape", [(60, 80, 3), (60, 80)], ids=["colour", "grey"])
def test_one_frame_is_segmented_and_drawn(tmp_path, color_shape):
    told = answer("segment", *frame_files(tmp_path, color_shape=color_shape), "-o", tmp_path / "s.png")
    assert told["objects"] <= told["masks"]
    assert cv2.imread(str(tmp_path / "s.png")).shape[1] == 1280


def test_an_image_of_one_pixel_is_segmented(tmp_path):
    files = frame_files(tmp_path, depth_shape=(1, 1), color_shape=(1, 1, 3))
    assert answer("segment", *files, "-o", tmp_path / "s.png")["masks"] == 0


def test_a_picture_without_a_floor_asks_for_the_direction_down(tmp_path):
    files = frame_files(tmp_path)
    asking = ended_as(0, "segment", *files, "-o", tmp_path / "s.png").stderr
    assert asking.startswith("note: no floor is in view")
    assert "--down X,Y,Z, e.g. --down 0,1,1" in asking
    # A camera that looks straight down: the surface 1.5 m before it is the floor.
    ended = look("segment", *files, "-o", tmp_path / "down.png", "--down", "0,0,1")
    assert "floor 1.50 m below the camera" in ended.stdout
    assert "note" not in ended.stderr


def test_a_profile_brings_the_intrinsics_of_both_cameras(tmp_path):
    files = frame_files(tmp_path, depth_shape=(480, 640), color_shape=(480, 640, 3))
    options = ("--profile", "seven_scenes", "--down", "-0.1,1,0", "-o", tmp_path / "s.png", "--overwrite")

    def drawn(intrinsics=None):
        if intrinsics is not None:
            (tmp_path / "camera-intrinsics.txt").write_text(intrinsics)
        said("segment", *files, *options)
        return (tmp_path / "s.png").read_bytes()

    # A folder of the data set has them in a file, which counts more; the same numbers give the same picture.
    by_profile = drawn()
    assert drawn("585 0 320\n0 585 240\n0 0 1\n") == by_profile
    assert drawn("300 0 320\n0 300 240\n0 0 1\n") != by_profile


def test_any_segmenter_can_be_asked_for(fastsam, tmp_path):
    chosen = ("--set", "mapper.perception.segmenter=fastsam", "-o", tmp_path / "s.png")
    said("segment", *frame_files(tmp_path), *chosen)


def test_a_pair_of_the_sam_family_is_added_checked_and_used(folder, tmp_path):
    pair = small_graphs.sam_pair(tmp_path / "mobile", low=64)
    said("models", "add", pair, "--kind", "sam", "--name", "sam")
    assert {path.name for path in folder.iterdir()} == {"sam.onnx", "sam.decoder.onnx", "manifest.json"}
    few = ["--set", "mapper.perception.sam.points_per_side=4", "--set", "mapper.perception.sam.stability=0.5"]
    assert answer("models", "check", "sam", *few)["masks"] == 32
    chosen = ("--set", "mapper.perception.segmenter=sam", *few, "-o", tmp_path / "s.png")
    said("segment", *frame_files(tmp_path), *chosen)


@pytest.mark.parametrize(("kind", "labels", "expected"), [
    ("fastsam", "", "no YOLOv8-seg graph"),
    ("semantic", "wall\nfloor\n", "has 3 classes, the manifest names 2"),
    ("semantic", "", "needs the names of its classes"),
])  # fmt: skip
def test_a_graph_that_no_run_could_use_is_not_added(folder, tmp_path, kind, labels, expected):
    (tmp_path / "names.txt").write_text(labels)
    file = small_graphs.scores_by_color(tmp_path / "a.onnx")
    assert expected in refusal("models", "add", file, "--kind", kind, "--labels", tmp_path / "names.txt")
    assert not folder.exists()


NETWORK = "mapper.perception.network.provider=cuda"


@pytest.mark.parametrize(("options", "shape", "expected"), [
    (["--intrinsics", "1,2,3"], (60, 80), "expected FX,FY,CX,CY"),
    (["--intrinsics=-1,2,3,4"], (60, 80), "focal lengths must be positive"),
    (["--down", "0,0,0"], (60, 80), "expected a direction"),
    (["--depth-units", "0"], (60, 80), "expected a number above 0"),
    (["--profile", "seven_scenes"], (60, 80), "give --intrinsics of depth"),
    (["--set", NETWORK, "--set", "mapper.perception.segmenter=fastsam"], (60, 80), "cuda"),
    ([], (30, 40), "80 x 60 pixels, .* of 40 x 30"),
    ([], (60, 80, 3), "16-bit PNG of one channel"),
])  # fmt: skip
def test_options_and_images_that_do_not_fit_are_refused(fastsam, tmp_path, options, shape, expected):
    files = frame_files(tmp_path, depth_shape=shape)
    assert re.search(expected, refusal("segment", *files, "-o", tmp_path / "s.png", *options))
