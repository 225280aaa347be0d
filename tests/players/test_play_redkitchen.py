from itertools import pairwise
import cv2
import numpy as np
import pytest
from hickory_stream.geometry.camera import backproject, project
from hickory_stream.geometry.rigid import apply, invert
from players import open_source


@pytest.fixture(scope="module")
def frames(redkitchen):
    raw = list(open_source(redkitchen).frames())
    assert len(raw) == 200
    return [raw[i].decode() for i in range(0, 200, 20)]


def _agreement(a, b):
    """Return the share of a's points, seen from b's pose, that lie within 5 cm of b's depth there."""
    points = backproject(a.depth_m, a.camera).reshape(-1, 3)[::7]
    points_b = apply(invert(b.world_from_camera) @ a.world_from_camera, points[np.isfinite(points[:, 2])])
    pixels = project(points_b, b.camera)
    pixels, points_b = pixels[np.isfinite(pixels).all(1)], points_b[np.isfinite(pixels).all(1)]
    at = np.round(pixels).astype(int)
    inside = ((at >= 0) & (at < [b.camera.width, b.camera.height])).all(1)
    seen = b.depth_m[at[inside, 1], at[inside, 0]]
    off = (points_b[inside, 2] - seen)[np.isfinite(seen)]
    # What is hidden behind a nearer surface in b says nothing.
    return float((np.abs(off) < 0.05)[off < 0.05].mean())


def test_frames_agree_in_an_upright_world(frames):
    assert np.median([_agreement(a, b) for a, b in pairwise(frames)]) > 0.9
    assert all(frame.world_from_camera[2, 1] < -0.8 for frame in frames)


def test_edges_of_depth_lie_on_edges_of_colour(frames):
    """The colour gradient on the depth edges is greater where the images are registered than beside it."""
    gains = []
    for frame in frames:
        depth = np.nan_to_num(frame.depth_m)
        edges = (np.abs(np.diff(depth, axis=1)) > 0.15) & (depth[:, 1:] > 0) & (depth[:, :-1] > 0)
        gray = cv2.cvtColor(frame.rgb, cv2.COLOR_RGB2GRAY).astype(float)
        gradient = np.abs(np.diff(cv2.GaussianBlur(gray, (0, 0), 1.5), axis=1))
        beside = np.mean([gradient[np.roll(edges, shift, axis=1)].mean() for shift in (-12, -9, 9, 12)])
        gains.append(gradient[edges].mean() / beside)
    assert np.median(gains) > 1.8
