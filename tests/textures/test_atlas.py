import numpy as np
import pytest
import trimesh
from hickory_stream.textures.atlas import atlas_of


def coil():
    """Return a ramp that winds three times over itself: seen from above, one sheet lies over the next."""
    turn = np.linspace(0, 6 * np.pi, 240)
    inner, outer = (np.stack([r * np.cos(turn), r * np.sin(turn), 0.05 * turn], axis=1) for r in (0.5, 1.0))
    i = np.arange(len(turn) - 1)
    n = len(turn)
    faces = np.concatenate([np.stack([i, i + n, i + 1], axis=1), np.stack([i + 1, i + n, i + n + 1], axis=1)])
    return trimesh.Trimesh(np.concatenate([inner, outer]), faces, process=False)


@pytest.mark.parametrize(
    "shape",
    [coil(), trimesh.creation.torus(0.5, 0.2), trimesh.creation.box((1, 0.6, 0.3)), trimesh.creation.icosphere(3)],
    ids=["coil", "torus", "box", "ball"],
)
def test_every_face_has_the_texels_that_its_size_is_worth(shape):
    texel = 0.005
    atlas = atlas_of(shape.vertices, shape.faces, texel, 4096)
    a, b, c = (atlas.corners_px[:, i] for i in range(3))
    in_image = 0.5 * np.abs((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
    owned = np.bincount(atlas.owner[atlas.owner >= 0], minlength=len(shape.faces))
    large = in_image > 30
    assert large.sum() > 10 or len(shape.faces) < 20
    assert np.abs(owned[large] / in_image[large] - 1).max() < 0.35
    assert owned.sum() == pytest.approx(in_image.sum(), rel=0.05)
    # Projection shrinks a face by no more than the angle to its side does.
    assert (in_image * texel * texel / shape.area_faces).min() > 0.3


def test_an_atlas_stays_within_its_side_and_holds_its_faces():
    ball = trimesh.creation.icosphere(3)
    atlas = atlas_of(ball.vertices, ball.faces, 0.0005, 128)
    assert atlas.owner.shape == (128, 128)
    assert atlas.corners_px.min() >= 0
    assert atlas.corners_px.max() <= 128


def test_more_charts_than_the_side_has_room_for_get_a_larger_one():
    cloud = np.random.default_rng(1).random((400, 3, 3))
    apart = trimesh.Trimesh(cloud.reshape(-1, 3), np.arange(1200).reshape(-1, 3), process=False)
    atlas = atlas_of(apart.vertices, apart.faces, 0.01, 32)
    assert 32 < atlas.side_px <= 128
    assert atlas.corners_px.min() >= 0


def test_what_views_do_not_show_finely_gets_a_small_atlas():
    box = trimesh.creation.box((1, 1, 1))
    assert atlas_of(box.vertices, box.faces, 0.1, 1024).side_px <= 64


def test_charts_are_not_mirrored():
    box = trimesh.creation.box((1, 0.6, 0.3))
    corners = atlas_of(box.vertices, box.faces, 0.01, 1024).corners_px
    edges = corners[:, 1:] - corners[:, :1]
    # Counter-clockwise seen from outside, so clockwise in numbers where y goes down.
    assert (edges[:, 0, 0] * edges[:, 1, 1] - edges[:, 0, 1] * edges[:, 1, 0] < 0).all()
