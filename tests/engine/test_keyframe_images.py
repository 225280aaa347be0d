from dataclasses import replace
import cv2
import numpy as np
import pytest
from hickory_stream.box_scene import SceneSource
from hickory_stream.config import JournalConfig
from hickory_stream.engine.effects import color_of, crop_of
from tests.mapping.mapping_fixtures import box_surface, observation

RAW = next(SceneSource(1).frames())
FRAME = RAW.decode()
WIDTH, HEIGHT = FRAME.camera.width, FRAME.camera.height


def seen(*box_px):
    x0, y0, x1, y1 = box_px
    return observation(0, box_surface((0, 0, 0)), box_px=(x0, y0, x1, y1))


def test_a_crop_has_a_margin_its_mask_and_a_matching_camera():
    crop = crop_of(FRAME, seen(20, 10, 40, 20), 0.1)
    assert crop.rgb.shape == (10 + 2 * 3, 20 + 2 * 4, 3)
    np.testing.assert_array_equal(crop.rgb, FRAME.rgb[7:23, 16:44])
    np.testing.assert_array_equal(crop.depth_m, FRAME.depth_m[7:23, 16:44])
    assert crop.mask[3:-3, 4:-4].all()
    assert crop.mask.sum() == 10 * 20
    assert (crop.camera.cx, crop.camera.cy) == (FRAME.camera.cx - 16, FRAME.camera.cy - 7)


def test_a_cut_out_ends_where_the_image_does():
    crop = crop_of(FRAME, seen(0, 0, WIDTH, HEIGHT), 0.5)
    np.testing.assert_array_equal(crop.rgb, FRAME.rgb)
    assert crop.mask.all()


@pytest.mark.parametrize("of_log", [b"as it came", None])
def test_the_image_of_the_log_is_kept_or_a_jpeg_is_made(of_log):
    red = replace(FRAME, rgb=np.full_like(FRAME.rgb, (200, 40, 10)))
    kept = color_of(replace(RAW, color_bytes=of_log), red, JournalConfig())
    assert kept is not None
    if of_log is not None:
        assert kept == of_log
    else:
        shown = np.asarray(cv2.imdecode(np.frombuffer(kept, np.uint8), cv2.IMREAD_COLOR))[..., ::-1]
        assert np.abs(shown.astype(int) - red.rgb).max() < 5


def test_no_image_is_kept_where_none_are_to_be():
    assert color_of(replace(RAW, color_bytes=b"x"), FRAME, replace(JournalConfig(), keep_images=False)) is None
