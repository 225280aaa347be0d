from dataclasses import replace
import cv2
import numpy as np
import pytest
from hickory_stream.errors import CalibrationError
from players.messages.calibration import lens_of
from players.messages.records import CameraInfo

K = np.array([[100.0, 0.0, 80.0], [0.0, 100.0, 60.0], [0.0, 0.0, 1.0]])
P = np.array([[90.0, 0.0, 81.0, 0.0], [0.0, 91.0, 61.0, 0.0], [0.0, 0.0, 1.0, 0.0]])


def _info(distortion, model="plumb_bob", size=(160, 120)):
    return CameraInfo(frame="camera", size=size, K=K, P=P, D=np.array(distortion), distortion_model=model)


def test_a_raw_image_is_described_by_k_a_rectified_one_by_p():
    lens = lens_of(_info((-0.2, 0, 0, 0, 0)), topic="/info", image_size=None, is_rectified=True)
    assert (lens.camera.fx, lens.camera.fy, lens.camera.cx, lens.camera.cy) == (90, 91, 81, 61)
    assert not lens.is_distorted
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


@pytest.mark.parametrize(("model", "d", "opencv_d"), [
    ("plumb_bob", (-0.3, 0.1, 0.0, 0.0, 0.0), (-0.3, 0.1, 0.0, 0.0)),
    ("plumb_bob", (-0.3,), (-0.3, 0.0, 0.0, 0.0)),
    ("Brown Conrady", (-0.3, 0.1, 0.001, 0.0, 0.02, 0.01), (-0.3, 0.1, 0.001, 0.0, 0.02, 0.01, 0.0, 0.0)),
    ("rational_polynomial", (-0.3, *(0.0,) * 10), (-0.3, 0.0, 0.0, 0.0)),
    ("equidistant", (-0.1, 0.0, 0.0, 0.0, 0.0), (-0.1, 0.0, 0.0, 0.0)),
    ("equidistant", (-0.1, 0.02), (-0.1, 0.02, 0.0, 0.0)),
])  # fmt: skip
def test_a_point_lands_where_the_pinhole_camera_sees_it(model, d, opencv_d):
    lens = lens_of(_info(d, model), topic="/info", image_size=None, is_rectified=False)
    point = np.array([[[0.4, -0.25, 1.0]]])
    distort = cv2.fisheye.projectPoints if model == "equidistant" else cv2.projectPoints
    distorted = distort(point, np.zeros(3), np.zeros(3), K, np.array(opencv_d))[0]
    raw_px = np.round(np.asarray(distorted).ravel()).astype(int)
    depth_m = np.full((120, 160), np.nan, dtype=np.float32)
    depth_m[raw_px[1] - 1 : raw_px[1] + 2, raw_px[0] - 1 : raw_px[0] + 2] = 1.0
    rows, columns = np.nonzero(np.isfinite(lens.rectified_depth(depth_m)))
    assert abs(columns.mean() - (100 * 0.4 + 80)) < 1.0
    assert abs(rows.mean() - (100 * -0.25 + 60)) < 1.0


@pytest.mark.parametrize(("d", "model", "size", "told"), [
    ((), "plumb_bob", (0, 0), "/info has no image size"),
    ((0.1,), "double_sphere", (160, 120), "/info has the distortion model 'double_sphere'; known are plumb_bob"),
    *((d, model, (160, 120), rf"/info: D = \[.*cannot be used.*of {model}") for model, d in (
        ("plumb_bob", (0.1, np.nan)), ("equidistant", (0.1,) * 5), ("plumb_bob", (0.1,) * 15), ("plumb_bob", (1e30,)),
    )),
])  # fmt: skip
def test_a_calibration_without_size_or_model_is_refused(d, model, size, told):
    with pytest.raises(CalibrationError, match=told):
        lens_of(_info(d, model, size), topic="/info", image_size=None, is_rectified=False)


def _pinhole(info, image_size, *, is_rectified=False):
    camera = lens_of(info, topic="/info", image_size=image_size, is_rectified=is_rectified).camera
    return camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy


@pytest.mark.parametrize(
    ("binning", "region", "image_size", "expected"),
    [
        ((2, 2), (0, 0, 0, 0), (80, 60), (80, 60, 50, 50, 40, 30)),
        ((2, 1), (0, 0, 160, 120), (80, 120), (80, 120, 50, 100, 40, 60)),
        ((1, 1), (20, 10, 100, 90), (100, 90), (100, 90, 100, 100, 60, 50)),
        ((2, 2), (20, 10, 100, 90), (50, 45), (50, 45, 50, 50, 30, 25)),
        ((2, 2), (20, 10, 100, 90), (25, 22), (25, 22, 25, 50 * 22 / 45, 14.75, 25.5 * 22 / 45 - 0.5)),
        # The driver has applied both itself, or the region sticks out of its sensor.
        ((2, 2), (20, 10, 100, 90), (160, 120), (160, 120, 100, 100, 80, 60)),
        ((1, 1), (100, 10, 100, 90), (160, 120), (160, 120, 100, 100, 80, 60)),
        ((1, 1), (0, 0, 0, 0), (320, 240), (320, 240, 200, 200, 160.5, 120.5)),
        # Another ratio of sides: frames of the calibration's size are used, if there are any.
        ((1, 1), (0, 0, 0, 0), (160, 90), (160, 120, 100, 100, 80, 60)),
    ],
)
def test_images_are_regions_of_the_sensor_binned_or_resized(binning, region, image_size, expected):
    assert _pinhole(replace(_info(()), binning=binning, region=region), image_size) == pytest.approx(expected)


def test_a_rectified_region_is_of_p_and_an_unset_size_the_images():
    assert _pinhole(_info((), size=(0, 0)), (150, 110))[:2] == (150, 110)
    info = replace(_info((-0.2,)), binning=(2, 2), region=(20, 10, 100, 90))
    assert _pinhole(info, (50, 45), is_rectified=True) == pytest.approx((50, 45, 45, 45.5, 30.5, 25.5))


@pytest.mark.parametrize(("fx", "cx", "cy"), [(100, 160, 120), (100, 40, 30), (1, 0, 0), (1, 80, 60), (100, 0, 0)])
def test_intrinsics_of_another_size_or_never_written_are_refused(fx, cx, cy):
    info = replace(_info(()), K=np.array([[fx, 0.0, cx], [0.0, fx, cy], [0.0, 0.0, 1.0]]))
    with pytest.raises(CalibrationError, match="are not those of images of 160x120 pixels"):
        lens_of(info, topic="/info", image_size=(160, 120), is_rectified=False)
