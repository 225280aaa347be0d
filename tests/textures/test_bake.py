from dataclasses import replace
import numpy as np
import pytest
import trimesh
from hickory_stream.geometry.camera import backproject
from hickory_stream.geometry.mesh import Mesh
from hickory_stream.geometry.rigid import apply
from hickory_stream.pictures.raycast import image_colors
from hickory_stream.textures.atlas import atlas_of
from hickory_stream.textures.bake import TextureConfig, textured
from hickory_stream.textures.textured_mesh import jpeg_bytes
from tests.shapes.shape_fixtures import shape_inputs

_SIZE = (0.8, 0.6, 0.5)
_GREY = 77


def pattern(points):
    """Return the true colour of places in the world: squares of 8 cm."""
    odd = np.floor((points + 0.037) / 0.08).astype(int).sum(axis=-1) % 2
    return np.where(odd[..., None] > 0, (200.0, 90.0, 60.0), (60.0, 110.0, 160.0))


def painted_crop(crop, gain):
    depth = np.where(np.isnan(crop.depth_m), np.float32(1), crop.depth_m)
    places = apply(crop.world_from_camera, backproject(depth, crop.camera).reshape(-1, 3).astype(np.float64))
    colors = pattern(places).reshape(*depth.shape, 3) * gain
    rgb = np.where(crop.mask[..., None], colors, (0, 255, 0)).clip(0, 255).astype(np.uint8)
    return replace(crop, rgb=rgb)


@pytest.fixture(scope="module")
def crops():
    """A box on the floor, seen from three sides and from above, never from below or from behind."""
    box = trimesh.creation.box(_SIZE).apply_translation([0, 0, 0.25])
    return [painted_crop(crop, 1.0) for crop in shape_inputs(box, 4, azimuths_rad=(-0.9, 1.2), noise=0.001).crops]


def box_mesh(crops):
    box = trimesh.creation.box(_SIZE).apply_translation([0, 0, 0.25])
    for _ in range(4):
        box = box.subdivide()
    normals = box.vertex_normals
    return Mesh(
        vertices=box.vertices,
        faces=box.faces,
        colors=np.full((len(box.vertices), 3), _GREY, np.uint8),
        # What looks away from the cameras was not seen.
        is_seen=(normals[:, 0] > -0.3) & (normals[:, 2] > -0.9),
    )


@pytest.fixture(scope="module")
def baked(crops):
    return textured(box_mesh(crops), np.eye(4), crops, TextureConfig(most_px=512))


def colors_on(baked, side):
    """Return places on the faces that look to a side, and their colours in 0..255."""
    mesh = baked.mesh
    corners = mesh.vertices[mesh.faces].astype(np.float64)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    looks = normals @ side > 0.9 * np.linalg.norm(normals, axis=1)
    places = corners[looks].mean(axis=1)
    return places, 255.0 * image_colors(baked.image, baked.uv[mesh.faces[looks]].mean(axis=1))


@pytest.mark.parametrize("side", [(1, 0, 0), (0, 0, 1)], ids=["front", "top"])
def test_a_side_that_was_seen_has_the_colours_of_the_object(baked, side):
    places, colors = colors_on(baked, np.array(side, float))
    wrong = np.abs(colors - pattern(places)).max(axis=1) > 40
    # Edges of squares are between two colours.
    assert wrong.mean() < 0.12
    # Nothing of the green around the object.
    assert (colors[:, 1] < 180).all()


def test_unseen_texture_is_plain_in_the_colours_around_it(baked):
    _, colors = colors_on(baked, np.array([0, 0, -1.0]))
    assert np.ptp(colors, axis=0).max() < 150
    steps = np.abs(np.diff(colors, axis=0)).max(axis=1)
    assert np.median(steps) < 10
    assert (np.abs(colors - (130, 100, 110)).max(axis=1) < 80).all()


def test_exposures_are_evened(crops):
    uneven = [painted_crop(crop, gain) for crop, gain in zip(crops, (0.7, 1.15, 0.85, 1.2), strict=True)]
    baked = textured(box_mesh(crops), np.eye(4), uneven, TextureConfig(most_px=512))
    ratios = []
    for side in ([1.0, 0, 0], [0, 1.0, 0], [0, -1.0, 0], [0, 0, 1.0]):
        places, colors = colors_on(baked, np.array(side))
        ratios += (colors / pattern(places)).mean(axis=1).tolist()
    # Every square is as bright as every other one; with the views' own exposures they differ by 0.7 to 1.2.
    low, high = np.percentile(ratios, [10, 90])
    assert high / low < 1.15


def test_the_same_inputs_give_the_same_bytes(crops, baked):
    again = textured(box_mesh(crops), np.eye(4), crops, TextureConfig(most_px=512))
    assert jpeg_bytes(again) == jpeg_bytes(baked)
    assert again.uv.tobytes() == baked.uv.tobytes()


def test_an_object_without_views_keeps_its_vertex_colours(crops):
    baked = textured(box_mesh(crops), np.eye(4), [], TextureConfig(most_px=64))
    assert (np.abs(baked.image.astype(int) - _GREY) <= 1).all()


def test_seen_and_generated_stay_marked(crops, baked):
    mesh = box_mesh(crops)
    assert (baked.mesh.is_seen == mesh.is_seen[baked.source]).all()
    assert (baked.mesh.vertices == mesh.vertices[baked.source]).all()
    assert (baked.source[baked.mesh.faces] == mesh.faces).all()


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
