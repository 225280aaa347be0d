import cv2
import numpy as np
import pytest
from hickory_stream.errors import CalibrationError
from players.messages.calibration import lens_of
from players.messages.records import CameraInfo

K = np.array([[100.0, 0.0, 80.0], [0.0, 100.0, 60.0], [0.0, 0.0, 1.0]])
P = np.array([[90.0, 0.0, 81.0, 0.0], [0.0, 91.0, 61.0, 0.0], [0.0, 0.0, 1.0, 0.0]])


def _info(distortion: tuple[float, ...], model: str = "plumb_bob", size: tuple[int, int] = (160, 120)) -> CameraInfo:
    return CameraInfo(frame="camera", size=size, K=K, P=P, D=np.array(distortion), distortion_model=model)


def test_a_rectified_image_is_described_by_p_and_left_as_it_is():
    lens = lens_of(_info((-0.2, 0, 0, 0, 0)), topic="/info", image_size=None, is_rectified=True)
    assert (lens.camera.fx, lens.camera.fy, lens.camera.cx, lens.camera.cy) == (90, 91, 81, 61)
    assert not lens.is_distorted


def test_a_raw_image_is_described_by_k_and_rectified():
    lens = lens_of(_info((-0.2, 0, 0, 0, 0)), topic="/info", image_size=None, is_rectified=False)
    assert (lens.camera.fx, lens.camera.cx) == (100, 80)
    assert lens.is_distorted


@pytest.mark.parametrize(
    ("model", "d"), [("plumb_bob", (-0.3, 0.1, 0.0, 0.0, 0.0)), ("equidistant", (-0.1, 0.0, 0.0, 0.0))]
)
def test_rectified_depth_holds_measured_values_only(model, d):
    lens = lens_of(_info(d, model), topic="/info", image_size=None, is_rectified=False)
    # Two distances: blending would make values in between.
    depth_m = np.where(np.arange(160) < 80, 1.0, 3.0).astype(np.float32) * np.ones((120, 1), dtype=np.float32)
    rectified = lens.rectified_depth(depth_m)
    assert set(np.unique(rectified[np.isfinite(rectified)])) == {1.0, 3.0}


@pytest.mark.parametrize(
    ("model", "d"), [("plumb_bob", (-0.3, 0.1, 0.0, 0.0, 0.0)), ("equidistant", (-0.1, 0.0, 0.0, 0.0))]
)
def test_a_point_lands_where_the_pinhole_camera_sees_it(model, d):
    lens = lens_of(_info(d, model), topic="/info", image_size=None, is_rectified=False)
    point = np.array([[[0.4, -0.25, 1.0]]])
    distort = cv2.fisheye.projectPoints if model == "equidistant" else cv2.projectPoints
    raw_px = np.round(np.asarray(distort(point, np.zeros(3), np.zeros(3), K, np.array(d))[0]).ravel()).astype(int)
    depth_m = np.full((120, 160), np.nan, dtype=np.float32)
    depth_m[raw_px[1] - 1 : raw_px[1] + 2, raw_px[0] - 1 : raw_px[0] + 2] = 1.0
    rows, columns = np.nonzero(np.isfinite(lens.rectified_depth(depth_m)))
    assert abs(columns.mean() - (100 * 0.4 + 80)) < 1.0
    assert abs(rows.mean() - (100 * -0.25 + 60)) < 1.0


def test_a_size_that_is_unset_is_taken_from_the_image():
    lens = lens_of(_info((), size=(0, 0)), topic="/info", image_size=(64, 48), is_rectified=False)
    assert (lens.camera.width, lens.camera.height) == (64, 48)


def test_a_size_that_nobody_knows_is_refused():
    with pytest.raises(CalibrationError, match="/info has no image size"):
        lens_of(_info((), size=(0, 0)), topic="/info", image_size=None, is_rectified=False)


def test_a_distortion_model_that_is_not_known_is_refused():
    with pytest.raises(CalibrationError, match="/info has the distortion model 'double_sphere'; known are plumb_bob"):
        lens_of(_info((0.1,), "double_sphere"), topic="/info", image_size=None, is_rectified=False)
