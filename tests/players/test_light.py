import numpy as np
from players.doctor.image_brightness import brightness_of, median_brightness


def image(*rgb):
    return np.broadcast_to(np.array(rgb, dtype=np.uint8), (40, 60, 3))


def test_a_black_image_is_dark_and_one_of_one_hue_is_grey():
    assert brightness_of(image(3, 2, 4)).is_dark
    assert not brightness_of(image(90, 80, 70)).is_dark
    assert brightness_of(image(90, 90, 90)).is_grey
    assert not brightness_of(image(90, 60, 40)).is_grey


def test_the_light_of_a_log_is_that_of_most_of_its_frames():
    assert median_brightness([]) is None
    found = median_brightness(
        [brightness_of(image(0, 0, 0)), brightness_of(image(90, 60, 40)), brightness_of(image(90, 60, 40))]
    )
    assert not found.is_dark
    assert not found.is_grey
