from dataclasses import replace
import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from hickory_stream.geometry.boxes import OrientedBox
from hickory_stream.geometry.rigid import from_rotation_translation
from hickory_stream.geometry.voxels import keys_of_cells
from hickory_stream.map_folder.saved_map import open_map
from hickory_stream.map_folder.writer import create_map_folder
from hickory_stream.pictures.raycast import Scene, Surface
from hickory_stream.pictures.render import render_map
from hickory_stream.pictures.render_parts import coarse, dots_of, ground_points, wall_surface
from hickory_stream.pictures.render_storeys import MARGIN_PX, MOST_STOREYS, Place, places_of, storeys_to_draw
from hickory_stream.pictures.render_view import floor_around
from hickory_stream.pictures.viewpoint import Viewpoint, from_above, from_corner
from hickory_stream.records import ObservedSpace
from tests.engine.snapshot_fixtures import make_snapshot

SIZE = (640, 300)


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    path = tmp_path_factory.mktemp("render") / "m"
    folder = create_map_folder(path, config={}, source={"uri": "desk.mcap"})
    folder.save(make_snapshot(folder))
    folder.finish(finished_cleanly=True)
    return open_map(path)


def square(z, owner, color=(255, 0, 0)):
    vertices = np.array([[-1, -1, z], [1, -1, z], [1, 1, z], [-1, 1, z]])
    return Surface(
        vertices=vertices, faces=[[0, 1, 2], [0, 2, 3]], colors=np.tile(np.uint8(color), (4, 1)), owner=owner
    )


def test_a_ray_meets_the_nearest_surface_with_a_facing_normal():
    scene = Scene([square(0.0, 3), square(1.0, 5, (0, 255, 0))])
    down = np.array([[0.0, 0.0, -1.0]] * 2)
    hits = scene.cast(np.array([[0.2, 0.1, 3.0], [5.0, 0.0, 3.0]]), down)
    assert hits.distance_m == pytest.approx([2.0, np.inf])
    assert hits.owners.tolist() == [5, -1]
    assert np.allclose(hits.normals[0], (0, 0, 1))
    assert np.allclose(hits.colors[0], (0, 1, 0))
    assert scene.is_occluded(np.array([[0.0, 0.0, 3.0]] * 2), down, 2.5).tolist() == [True, True]
    assert scene.is_occluded(np.array([[0.0, 0.0, 3.0]]), down[:1], 1.5).tolist() == [False]


def test_the_nearest_surface_is_found_with_its_owner():
    distance_m, owners = Scene([square(0.0, 3), square(1.0, 5)]).nearest(np.array([[0, 0, 0.25], [3.0, 0, 1.0]]))
    assert np.allclose(distance_m, [0.25, 2.0])
    assert owners.tolist() == [3, 5]


def test_a_scene_without_surfaces_meets_nothing():
    ray = np.array([[0.0, 0.0, 1.0]])
    empty = Scene([])
    assert empty.cast(ray, ray).owners.tolist() == [-1]
    assert not empty.is_occluded(ray, ray, 1.0).any()
    assert np.isinf(empty.nearest(ray)[0]).all()


coordinate = st.floats(-3, 3)


@given(
    points=st.lists(st.tuples(coordinate, coordinate, coordinate), min_size=1, max_size=20),
    azimuth=st.floats(0, 6.3),
    elevation=st.floats(0.2, 1.3),
)
def test_every_viewpoint_frames_all_points(points, azimuth, elevation):
    world = np.array(points)
    for viewpoint in (from_above(world, 320, 200, 20), from_corner(world, azimuth, elevation, 320, 200, 20)):
        pixels = viewpoint.project(world)
        assert (pixels >= 20 - 1e-3).all()
        assert (pixels <= np.array([300, 180]) + 1e-3).all()
        origins, directions = viewpoint.rays(pixels)
        offsets = world - origins
        along = np.einsum("nc,nc->n", offsets, directions)
        assert (along > 0).all()
        assert np.abs(offsets - along[:, None] * directions).max() < 1e-3


def is_like(image, color):
    """Return how many pixels have the hue of a colour: lighting scales it."""
    pixels = image.reshape(-1, 3).astype(float)
    cosine = pixels @ np.array(color) / np.maximum(np.linalg.norm(pixels, axis=1), 1) / np.linalg.norm(color)
    return int((cosine > 0.995).sum())


def test_a_mesh_shows_its_colour_from_above_and_the_corner(saved):
    image = render_map(saved, {2}, SIZE)
    assert image.shape == (300, 640, 3)
    assert image.dtype == np.uint8
    wood, blue = (150, 110, 70), (60, 90, 180)
    for half in (image[:, :200], image[:, 330:]):
        assert is_like(half, wood) > 300
        assert is_like(half, blue) > 50


def test_a_far_mesh_is_lit_with_few_triangles_and_its_outline():
    sphere = trimesh.creation.icosphere(subdivisions=4, radius=0.5)
    colors = np.full((len(sphere.vertices), 3), 128, np.uint8)
    fine = Surface(vertices=sphere.vertices, faces=sphere.faces, colors=colors, owner=7)
    bounds = np.array([[-1.0, -1, 0], [1, 1, 1]])
    near, far = from_above(0.1 * bounds, 600, 600, 0), from_above(5 * bounds, 200, 200, 0)
    assert coarse(fine, near) is fine
    few = coarse(fine, far)
    assert len(few.faces) < len(fine.faces) / 10
    places = np.stack(np.meshgrid(np.arange(80, 120), np.arange(80, 120)), axis=-1).reshape(-1, 2)
    owners = [Scene([surface]).cast(*far.rays(places)).owners for surface in (fine, few)]
    assert 250 < (owners[0] == 7).sum() < 400
    assert (owners[0] != owners[1]).mean() < 0.06


def test_a_mesh_below_a_pixel_is_lit_with_few_triangles():
    sphere = trimesh.creation.icosphere(subdivisions=4, radius=0.05)
    colors = np.full((len(sphere.vertices), 3), 128, np.uint8)
    fine = Surface(vertices=sphere.vertices + 0.3, faces=sphere.faces, colors=colors, owner=7)
    few = coarse(fine, from_above(np.array([[-50.0, -50, 0], [50, 50, 1]]), 200, 200, 0))
    assert 0 < len(few.faces) < len(fine.faces) / 10
    assert np.allclose(few.vertices.mean(axis=0), 0.3, atol=0.02)


@pytest.mark.parametrize("side_m", [0.003, 0.02, 0.3])
def test_one_vertex_of_each_cell_stays_counted_or_sorted(side_m):
    vertices = np.random.default_rng(4).uniform(-1, 1, (500, 3)).astype(np.float32)
    surface = Surface(
        vertices=vertices, faces=np.arange(498)[:, None] + [0, 1, 2], colors=np.zeros((500, 3), np.uint8), owner=1
    )
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    of_a_pixel = Viewpoint(
        world_from_camera=np.eye(4), focal_px=3 / side_m, is_orthographic=True, width=600, height=600
    )
    few = coarse(surface, of_a_pixel)
    cells = np.floor(vertices.astype(np.float64) / of_a_pixel.pixel_m(vertices) / 3)
    assert (few is surface) == (side_m < 0.004)
    if few is not surface:
        assert len(few.vertices) == len(np.unique(cells, axis=0))
        assert ((few.vertices >= low) & (few.vertices <= high)).all()


def test_the_light_on_a_mesh_of_any_size_is_made_within_memory():
    # Of so many cells along two axes that their product, in whole numbers of 64 bits, is 0.
    huge = np.float32(2.0**32)
    vertices = np.array([[0, 0, 0], [huge, 0, 0], [huge, huge, 0], [0, huge, 1]], np.float32)
    surface = Surface(
        vertices=vertices, faces=np.array([[0, 1, 2], [0, 2, 3]]), colors=np.zeros((4, 3), np.uint8), owner=1
    )
    of_a_metre = Viewpoint(world_from_camera=np.eye(4), focal_px=3.0, is_orthographic=True, width=600, height=600)
    assert 1 <= len(coarse(surface, of_a_metre).faces) <= 2


def test_dots_are_as_large_as_the_spacing_of_the_points(saved):
    grid = 0.01 * np.indices((40, 30, 1)).reshape(3, -1).T
    tracked = replace(
        saved.snapshot.objects[0], points_world=grid.astype(np.float32), colors=np.zeros((1200, 3), np.uint8)
    )
    assert dots_of(tracked).half_m == pytest.approx(0.006, rel=1e-4)


def test_the_same_map_gives_the_same_picture(saved):
    assert np.array_equal(render_map(saved, {2, 4}, SIZE), render_map(saved, {2, 4}, SIZE))


@pytest.mark.parametrize("layers", [{1}, {2}, {3}, {4}, {1, 2, 3, 4}])
def test_every_layer_differs_from_a_map_without_objects(saved, layers):
    empty = replace(saved, snapshot=replace(saved.snapshot, objects=()))
    image, bare = render_map(saved, layers, SIZE), render_map(empty, layers, SIZE)
    assert (np.abs(image[60:].astype(int) - bare[60:]).max(axis=2) > 40).sum() > 1500


def test_a_sketch_is_drawn_with_layer_three_and_told(saved):
    first = saved.snapshot.objects[0]
    assert first.shape is not None
    bare = replace(first, shape=None)
    sketched = replace(bare, sketch=first.shape.fitted)
    pictures = [
        render_map(replace(saved, snapshot=replace(saved.snapshot, objects=(tracked,))), {3}, SIZE)
        for tracked in (bare, sketched)
    ]
    assert (np.abs(pictures[0][60:].astype(int) - pictures[1][60:]).max(axis=2) > 20).sum() > 500
    assert (pictures[0][:30] != pictures[1][:30]).any()


def test_tentative_tracks_are_not_drawn(saved):
    without = replace(saved, snapshot=replace(saved.snapshot, objects=saved.snapshot.objects[:2]))
    assert np.array_equal(render_map(saved, {1}, SIZE), render_map(without, {1}, SIZE))


def test_a_wall_before_the_objects_does_not_hide_them(saved):
    submap = saved.snapshot.submaps[0]
    space = submap.observed_space
    # A closed room around the objects, observed from the inside only.
    cells = np.stack(np.meshgrid(*[np.arange(-30, 30)] * 2, np.arange(0, 50), indexing="ij"), axis=-1).reshape(-1, 3)
    is_wall = (cells[:, :2] == -30).any(axis=1) | (cells[:, :2] == 29).any(axis=1) | (cells[:, 2] == 0)
    walled = replace(
        space, structure=np.sort(keys_of_cells(cells[is_wall])), free=np.sort(keys_of_cells(cells[~is_wall]))
    )
    room = replace(saved.snapshot, submaps=(replace(submap, observed_space=walled),))
    open_air = replace(saved.snapshot, submaps=())
    blue = (60, 90, 180)
    in_room = is_like(render_map(replace(saved, snapshot=room), {2}, SIZE)[:, 330:], blue)
    outside = is_like(render_map(replace(saved, snapshot=open_air), {2}, SIZE)[:, 330:], blue)
    assert in_room > 0.9 * outside > 0


def test_a_slope_is_ground_at_its_own_height_and_no_wall(saved):
    # It rises by 1.5 m over 6 m, beside a wall.
    x, y = np.stack(np.meshgrid(np.arange(120), np.arange(40), indexing="ij")).reshape(2, -1)
    wall = np.stack(np.meshgrid(np.arange(120), [40], np.arange(60), indexing="ij"), axis=-1).reshape(-1, 3)
    slope, wall = np.column_stack([x, y, x // 4]), wall[wall[:, 2] >= wall[:, 0] // 4]
    free, structure = (np.sort(keys_of_cells(np.concatenate(parts))) for parts in (
        (slope + np.array([0, 0, 1]), wall - np.array([0, 1, 0])), (slope, wall),
    ))  # fmt: skip
    space = ObservedSpace(voxel_m=0.05, free=free, structure=structure, floor_z_m=0.0)
    submap = replace(saved.snapshot.submaps[0], world_from_submap=np.eye(4), observed_space=space)
    floor = floor_around(np.zeros((1, 3)), 0.0, ground_points(submap, 0.0))
    assert np.abs(floor.above_m((slope + 0.5) * 0.05)).max() < 0.1
    assert np.median(floor.above_m((wall + 0.5) * 0.05)) > 0.5
    faces = wall_surface(submap, floor.above_m, None).vertices
    assert len(faces) > 1000
    assert faces[:, 1].min() > 1.9


@pytest.mark.parametrize(("layers", "size"), [(set(), SIZE), ({5}, SIZE), ({2}, (100, 100))])
def test_layers_and_sizes_out_of_range_are_refused(saved, layers, size):
    with pytest.raises(ValueError, match="found"):
        render_map(saved, layers, size)


STOREY_M = 3.0


def at_height(tracked, new_id, z_m):
    """Return the object without a shape, so much higher."""
    up = np.array([0.0, 0.0, z_m])
    box = OrientedBox(
        world_from_box=from_rotation_translation(np.eye(3), up) @ tracked.box.world_from_box,
        half_extents_m=tracked.box.half_extents_m,
    )
    return replace(tracked, id=new_id, shape=None, box=box, points_world=tracked.points_world + up.astype(np.float32))


def house(snapshot, *counts):
    """Return storeys with so many objects each, the lowest at 0."""
    first = next(tracked for tracked in snapshot.objects if tracked.phase != "tentative")
    objects, submaps = [], []
    for storey, count in enumerate(counts):
        floor_m = storey * STOREY_M
        space = replace(snapshot.submaps[0].observed_space, floor_z_m=floor_m)
        submaps.append(replace(snapshot.submaps[0], id=storey, observed_space=space))
        base_m = floor_m - float(first.box.corners_world()[:, 2].min())
        objects += [at_height(first, len(objects) + i, base_m) for i in range(count)]
    return replace(snapshot, submaps=tuple(submaps), objects=tuple(objects))


def test_every_object_of_a_house_is_in_the_storeys_it_reaches(saved):
    snapshot = house(saved.snapshot, 2, 1, 3)
    pit = at_height(snapshot.objects[0], 99, -2.0)
    snapshot = replace(snapshot, objects=(*snapshot.objects, pit))
    storeys = storeys_to_draw(snapshot, None)
    assert [storey.floor_m for storey in storeys] == [0.0, STOREY_M, 2 * STOREY_M]
    assert [[tracked.id for tracked in storey.objects] for storey in storeys] == [[0, 1, 99], [2], [3, 4, 5]]


def test_one_storey_is_drawn_where_there_is_one_or_one_was_named(saved):
    (only,) = storeys_to_draw(saved.snapshot, None)
    assert only.floor_m is None
    assert len(only.objects) == sum(tracked.phase != "tentative" for tracked in saved.snapshot.objects)
    (named,) = storeys_to_draw(house(saved.snapshot, 2, 1), STOREY_M)
    assert [tracked.id for tracked in named.objects] == [2]


def test_of_a_tower_the_fullest_storeys_are_drawn_lowest_first(saved):
    storeys = storeys_to_draw(house(saved.snapshot, 1, 2, 1, 2, 2, 2, 2, 2), None)
    assert [storey.floor_m for storey in storeys] == [STOREY_M * i for i in (1, 3, 4, 5, 6, 7)]
    assert len(storeys) == MOST_STOREYS


@pytest.mark.parametrize("count", range(1, MOST_STOREYS + 1))
@pytest.mark.parametrize("size", [(1600, 756), (480, 196), (700, 2000)])
@pytest.mark.parametrize("extent", [(20.0, 4.0), (4.0, 20.0)])
def test_all_storeys_are_in_the_picture_without_overlap(count, size, extent):
    width, height = size
    covered = np.zeros((height, width), np.uint8)
    places = places_of(count, width, height, np.array(extent))
    assert len(places) == count
    for place in (view for views in places for view in views):
        assert place.x >= 0
        assert place.y >= 0
        part = place.of(covered)
        assert part.shape == (place.height, place.width)
        part += 1
        assert min(place.width, place.height) > 2 * place.margin_px + 20 or count == 1
    assert covered.max() == 1
    # Of five, a sixth place is empty.
    assert covered.mean() > (0.75 if count == 5 else 0.95)
    assert len({(above.width, above.height, above.margin_px) for above, _ in places}) == 1


def test_a_single_storey_has_its_views_beside_each_other():
    ((above, corner),) = places_of(1, 1600, 756, np.array([30.0, 10.0]))
    assert above == Place(x=0, y=0, width=736, height=756, margin_px=MARGIN_PX)
    assert corner == Place(x=738, y=0, width=862, height=756, margin_px=MARGIN_PX)


def test_the_lower_floor_is_seen_below_an_equal_upper_one(saved):
    lower = house(saved.snapshot, 1, 1)
    first, second = lower.objects
    red, blue = (np.full_like(first.colors, color) for color in ((220, 20, 20), (20, 20, 220)))
    objects = (replace(first, colors=red), replace(second, colors=blue))
    image = render_map(replace(saved, snapshot=replace(lower, objects=objects)), {1}, (960, 500)).astype(int)
    for half, channel in ((image[70:, :479], 0), (image[70:, 482:], 2)):
        colored = half[..., channel] > half[..., 2 - channel] + 60
        other = half[..., 2 - channel] > half[..., channel] + 60
        assert colored.sum() > 200 > 4 * other.sum()
