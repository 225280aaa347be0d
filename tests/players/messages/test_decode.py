from types import SimpleNamespace
import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hickory_stream.errors import RecordingError
from players.messages.image_decoding import (
    color_of_pixels,
    compressed_size,
    decode_color,
    decode_depth_png,
    depth_of_pixels,
    png_part,
    raw_pixels,
)
from tests import player_scenes as scenes

RED = np.zeros((4, 6, 3), dtype=np.uint8)
RED[..., 0] = 200
WAVES = (128 + 100 * np.sin(np.arange(40 * 60 * 3) / 50)).astype(np.uint8).reshape(40, 60, 3)


def _message(encoding, pixels, padding=0, is_big=False):
    wire = pixels.astype(pixels.dtype.newbyteorder(">" if is_big else "<"))
    rows = np.pad(wire.view(np.uint8).reshape(len(pixels), -1), ((0, 0), (0, padding)), constant_values=7)
    height, width = pixels.shape[:2]
    fields = {"height": height, "width": width, "step": rows.shape[1], "data": rows.ravel()}
    return SimpleNamespace(encoding=encoding, is_bigendian=int(is_big), **fields)


@pytest.mark.parametrize(("encoding", "pixel"), [
    ("rgb8", [200, 0, 0]), ("bgr8", [0, 0, 200]), ("8UC3", [0, 0, 200]),
    ("rgba8", [200, 0, 0, 9]), ("bgra8", [0, 0, 200, 9]), ("8UC4", [0, 0, 200, 9]),
])  # fmt: skip
@pytest.mark.parametrize("padding", [0, 5])
def test_raw_colour_of_every_order_and_step_is_the_same_red(encoding, pixel, padding):
    pixels = np.tile(np.array(pixel, dtype=np.uint8), (4, 6, 1))
    read = color_of_pixels(raw_pixels(_message(encoding, pixels, padding), "image"), encoding)
    np.testing.assert_array_equal(read, RED)


@pytest.mark.parametrize("is_big", [False, True])
def test_grey_of_8_and_16_bits_is_grey_in_every_channel(is_big):
    grey = np.arange(24, dtype=np.uint8).reshape(4, 6)
    eight = color_of_pixels(raw_pixels(_message("mono8", grey), "image"), "mono8")
    wide = grey.astype(np.uint16) * 256 + 255
    sixteen = color_of_pixels(raw_pixels(_message("mono16", wide, is_big=is_big), "image"), "mono16")
    np.testing.assert_array_equal(eight, np.dstack([grey] * 3))
    np.testing.assert_array_equal(sixteen, eight)


@pytest.mark.parametrize("is_big", [False, True])
@pytest.mark.parametrize(("encoding", "raw", "expected"), [
    ("16UC1", np.uint16([[0, 1500], [65535, 250]]), [[np.nan, 1.5], [np.nan, 0.25]]),
    ("32FC1", np.float32([[np.nan, np.inf, -np.inf], [0.0, -1.0, 2.5]]), [[np.nan] * 3, [np.nan, np.nan, 2.5]]),
])  # fmt: skip
@pytest.mark.parametrize("padding", [0, 6])
def test_depth_is_metres_in_any_byte_order_or_no_return(encoding, raw, expected, is_big, padding):
    depth = depth_of_pixels(raw_pixels(_message(encoding, raw, padding, is_big), "depth"))
    np.testing.assert_allclose(depth, expected, rtol=1e-6)
    assert depth.dtype == np.float32


def test_the_last_row_may_lack_its_padding():
    message = _message("mono8", np.arange(24, dtype=np.uint8).reshape(4, 6), padding=10)
    message.data = message.data[:-10]
    np.testing.assert_array_equal(raw_pixels(message, "image").ravel(), np.arange(24))


@pytest.mark.parametrize("size", [0, 10, 23])
def test_too_few_raw_pixels_are_refused_with_the_numbers(size):
    message = _message("mono8", np.arange(24, dtype=np.uint8).reshape(4, 6))
    message.data = message.data[:size]
    with pytest.raises(RecordingError, match=rf"image holds {size} bytes; expected 6x4 mono8"):
        raw_pixels(message, "image")


def test_png_is_exact_jpeg_near_and_zeros_behind_do_no_harm():
    np.testing.assert_array_equal(decode_color(scenes.png_bytes(WAVES[..., ::-1]), "image"), WAVES)
    near = decode_color(scenes.jpeg_bytes(WAVES[..., ::-1]), "image").astype(int) - WAVES
    assert np.abs(near).mean() < 12
    assert decode_color(scenes.jpeg_bytes(WAVES) + bytes(1000), "image").shape == WAVES.shape


@given(st.floats(0.0, 0.99), st.booleans())
def test_a_torn_image_is_refused_wherever_it_was_cut(share, is_png):
    data = scenes.png_bytes(WAVES) if is_png else scenes.jpeg_bytes(WAVES)
    with pytest.raises(RecordingError, match=r"image (is|cannot)"):
        decode_color(data[: int(len(data) * share)], "image")


@given(st.binary(max_size=200))
def test_noise_is_refused_and_never_crashes(data):
    with pytest.raises(RecordingError, match="image"):
        decode_color(data, "image")
    assert compressed_size(data) is None or isinstance(compressed_size(data), tuple)


def test_depth_png_has_its_units_16_bits_and_may_have_a_header():
    raw = np.array([[0, 5000], [65535, 10000]], dtype=np.uint16)
    depth = decode_depth_png(scenes.png_bytes(raw), 5000.0, "depth")
    np.testing.assert_allclose(depth, [[np.nan, 1.0], [np.nan, 2.0]], rtol=1e-6)
    with pytest.raises(RecordingError, match="uint8 with 1 channels; depth must be 16 bits"):
        decode_depth_png(scenes.png_bytes(np.zeros((3, 3), dtype=np.uint8)), 1000.0, "depth")
    data = scenes.png_bytes(np.ones((3, 3), dtype=np.uint16))
    assert png_part(bytes(12) + data, "depth") == png_part(data, "depth") == data
    with pytest.raises(RecordingError, match="depth holds no PNG"):
        png_part(bytes(40), "depth")


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
def test_the_size_of_a_compressed_image_is_read_from_its_header(suffix):
    data = bytes(cv2.imencode(suffix, WAVES)[1])
    assert compressed_size(data) == (60, 40)
    assert compressed_size(data[:10]) is None
