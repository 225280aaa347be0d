from dataclasses import replace
import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hickory_stream.alignment.align import align
from hickory_stream.alignment.object_map import object_map
from hickory_stream.changes.page import COLORS, Footprint, plan_svg
from hickory_stream.changes.records import Verdict
from hickory_stream.geometry.display import color_of_id
from hickory_stream.geometry.mesh import mesh_of_glb, sha256_of, write_glb
from hickory_stream.geometry.voxels import sorted_unique
from hickory_stream.map_folder.saved_map import open_map
from hickory_stream.map_folder.writer import create_map_folder
from hickory_stream.navigation.free_space import free_space_of
from hickory_stream.navigation.robot import load_robot
from hickory_stream.navigation.search import NoPath, NoPathReason
from hickory_stream.pictures.labels import draw_labels, flat_labels, most_visible, place_labels
from hickory_stream.pictures.legend import GENERATED, legend_of, with_tint, with_tinted_image
from hickory_stream.pictures.render import labels_of, render_map
from hickory_stream.pictures.render_alignment import alignment_meanings, render_alignment
from hickory_stream.pictures.render_navigation import render_plan
from hickory_stream.pictures.render_parts import dots_of
from hickory_stream.pictures.viewpoint import from_above, from_corner
from hickory_stream.textures.textured_mesh import TexturedMesh
from tests.alignment.map_fixtures import frame, furniture, snapshot_of
from tests.engine.snapshot_fixtures import box_mesh, make_object, make_snapshot, placed
from tests.navigation.rooms import snapshot, table, tracked


def colors_in(image):
    packed = sorted_unique(image.reshape(-1, 3).astype(np.int64) @ (1 << 16, 1 << 8, 1))
    return {tuple(one.to_bytes(3, "big")) for one in packed.tolist()}


def dark(object_id):
    return tuple(int(0.55 * c) for c in color_of_id(object_id))


def test_a_legend_shows_every_colour_and_wraps_to_its_width():
    entries = [(f"meaning {i}", (10 * i, 200, 30)) for i in range(9)]
    wide, narrow = legend_of(entries, 2000), legend_of(entries, 200)
    assert narrow.shape[1] <= 200
    assert len(narrow) > 3 * len(wide)
    for image in (wide, narrow):
        assert {color for _, color in entries} <= colors_in(image)


def test_generated_surface_is_tinted_and_explained(tmp_path):
    maps = []
    for name in ("seen", "generated"):
        folder = create_map_folder(tmp_path / name, config={}, source={"uri": "desk.mcap"})
        made, objects = make_snapshot(folder), []
        for item in made.objects:
            if item.shape is not None and name == "generated":
                mesh = mesh_of_glb((folder.shapes / item.shape.mesh_name).read_bytes())
                mesh = replace(mesh, is_seen=np.zeros(len(mesh.vertices), bool))
                write_glb(mesh, folder.shapes / item.shape.mesh_name)
                item = replace(item, shape=replace(item.shape, mesh_sha256=sha256_of(mesh)))
            objects.append(item)
        folder.save(replace(made, objects=tuple(objects)))
        folder.finish(finished_cleanly=True)
        maps.append(open_map(tmp_path / name))
    seen, tinted = (render_map(one, {2}, (640, 300))[50:].astype(int) for one in maps)
    towards = tinted[..., 0] + tinted[..., 2] - 2 * tinted[..., 1] - (seen[..., 0] + seen[..., 2] - 2 * seen[..., 1])
    assert (towards > 60).sum() > 2000
    assert GENERATED in colors_in(seen)
    assert GENERATED not in colors_in(render_map(maps[0], {3}, (640, 300)))


def test_a_texture_is_tinted_on_generated_faces_only():
    box = box_mesh((1.0, 1.0, 1.0), (90, 90, 90))
    is_seen = np.ones(len(box.vertices), bool)
    is_seen[box.faces[0]] = False
    uv = np.zeros((len(box.vertices), 2), np.float32)
    uv[box.faces[0]] = [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)]
    image = np.full((64, 64, 3), 90, np.uint8)
    mesh = replace(box, faces=box.faces[:1], is_seen=is_seen)
    textured = TexturedMesh(mesh=mesh, uv=uv, image=image, source=np.arange(len(uv)))
    found = with_tinted_image(textured)
    assert (found[5, 5] == with_tint(image[5, 5], np.array(False))).all()
    assert (found[60, 60] == 90).all()
    assert 0.45 < (found != 90).any(axis=2).mean() < 0.55
    assert (with_tinted_image(replace(textured, mesh=replace(mesh, is_seen=~is_seen))) == image).all()


def test_a_plan_numbers_its_objects_and_explains_its_colours():
    room, robot = snapshot(tracked(7, table())), load_robot("jackal")
    space = free_space_of(room, robot, cell_m=0.1, unknown="free")
    none = NoPath(reason=NoPathReason.UNREACHABLE, text="there is a wall")
    bare, found = (
        render_plan(of, space, none, np.array([0.5, 0.5]), np.array([5.0, 3.0])) for of in (snapshot(), room)
    )
    assert dark(7) in colors_in(found)
    assert dark(7) not in colors_in(bare)
    assert {(250, 250, 248), (222, 235, 247), (148, 154, 166), (208, 210, 216)} <= colors_in(found[-40:])


def test_both_ids_of_a_pair_have_one_colour():
    items = furniture(8, 2)
    map_a, map_b = object_map(snapshot_of(items, np.eye(4))), object_map(snapshot_of(items, frame(30, 1, 0), 1))
    shifted = replace(map_b, ids=map_b.ids + 20)
    answer = align(map_a, shifted)
    image = render_alignment(map_a, shifted, answer, (1600, 800))
    assert len(answer.pairs) == 8
    assert {dark(int(i)) for i in map_a.ids} <= colors_in(image)
    assert not {dark(int(i)) for i in shifted.ids} & colors_in(image)
    assert {color for _, color in alignment_meanings(is_aligned=True)} <= colors_in(image[-60:])


def test_small_objects_of_a_plan_are_labelled_above_large_ones():
    square = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]])
    outlines = {1: [300 * square], 2: [100 + 60 * square], 3: [np.array([[220.0, 220]]) + 4 * square]}
    labels = {label.object_id: label for label in flat_labels(outlines, (300, 300), {3: "b3"})}
    assert [labels[i].text for i in (1, 2, 3)] == ["1", "2", "b3"]
    x0, y0, x1, y1 = labels[2].box_px
    assert 100 <= x0 < x1 <= 160
    assert 100 <= y0 < y1 <= 160
    assert labels[3].is_beside


def test_a_page_of_changes_has_ids_a_scale_and_the_colours_on_it():
    one, other, _ = make_snapshot().objects
    gone, still = COLORS[Verdict.GONE], COLORS[Verdict.STILL_THERE]
    prints = [Footprint(item=one, color=gone, is_dashed=False), Footprint(item=other, color=still, is_dashed=True)]
    meanings = {gone: "gone", still: "still there", COLORS[Verdict.MOVED]: "moved"}
    svg = plan_svg(prints, [], meanings, "dashed: later")
    assert all(f">{text}</text>" in svg for text in (one.id, other.id, "1 m"))
    assert f'background:{gone}"></i> gone<' in svg
    assert "still there" in svg
    assert "moved" not in svg
    assert plan_svg([], [], meanings, "") == ""


STEP_PX = 4


def overlaps(labels):
    boxes = [label.box_px for label in labels]
    return sum(
        a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3] for i, a in enumerate(boxes) for b in boxes[:i]
    )


def owners_of(*squares, shape=(100, 150)):
    """Return whose surface is seen: squares (id, column, row, side), later ones over earlier ones."""
    owners = np.full(shape, -1, np.int32)
    for object_id, column, row, side in squares:
        owners[row : row + side, column : column + side] = object_id
    return owners


squares_of_ids = st.tuples(st.integers(0, 149), st.integers(0, 99), st.integers(1, 40))


@given(st.lists(squares_of_ids, min_size=1, max_size=20))
def test_no_label_covers_another_or_leaves_the_picture(squares):
    ids = list(range(3, 3 + len(squares)))
    owners = owners_of(*((i, *found) for i, found in zip(ids, squares, strict=True)))
    hidden = np.array([(STEP_PX * x, STEP_PX * y) for x, y, _ in squares], dtype=float)
    labels = place_labels(ids, owners, STEP_PX, hidden)
    assert [label.object_id for label in labels] == ids
    assert overlaps(labels) == 0
    boxes = np.array([label.box_px for label in labels])
    assert (boxes >= 0).all()
    assert (boxes[:, 2:] <= (600, 400)).all()


def test_a_label_is_inside_a_large_object_and_beside_a_small_one():
    owners = owners_of((1, 10, 10, 40), (2, 28, 28, 3))
    large, small = place_labels([1, 2], owners, STEP_PX, np.zeros((2, 2)))
    assert not large.is_beside
    x0, y0, x1, y1 = (end // STEP_PX for end in large.box_px)
    assert (owners[y0 : y1 + 1, x0 : x1 + 1] == 1).all()
    assert small.is_beside
    assert owners[small.place_px[1] // STEP_PX, small.place_px[0] // STEP_PX] == 2
    image = np.full((400, 600, 3), 255, np.uint8)
    draw_labels(image, [large, small])
    dark = tuple(int(0.55 * c) for c in color_of_id(2))
    assert (image[small.box_px[1], small.box_px[0]] == dark).all()
    assert (image[small.place_px[1], small.place_px[0]] == dark).all()


def test_an_object_seen_through_rungs_is_labelled_where_visible():
    # Object 2 shows at the right of object 1, which hides its middle.
    owners = owners_of((2, 20, 20, 40), (1, 10, 10, 40))
    label = place_labels([1, 2], owners, STEP_PX, np.zeros((2, 2)))[1]
    assert owners[label.place_px[1] // STEP_PX, label.place_px[0] // STEP_PX] == 2


def test_stacked_objects_are_labelled_apart_in_both_views():
    heights = {1: 0.7, 2: 0.12, 3: 0.1, 4: 0.08}
    places = {1: (0.0, 0.0, 0.35), 2: (0.0, 0.0, 0.76), 3: (0.05, 0.0, 0.87), 4: (0.02, 0.03, 0.96)}
    objects = []
    for i, place in places.items():
        side = 1.2 if i == 1 else 0.12
        made = make_object(i, box_mesh((side, side, heights[i]), (120, 90, 60)), placed(*place))
        objects.append(replace(made, id=i))
    corners = np.concatenate([tracked.box.corners_world() for tracked in objects])
    for viewpoint in (from_above(corners, 300, 240, 30), from_corner(corners, 0.4, 0.66, 300, 240, 30)):
        labels = labels_of(viewpoint, objects, [dots_of(tracked) for tracked in objects])
        assert [label.object_id for label in labels] == [1, 2, 3, 4]
        assert overlaps(labels) == 0


def test_a_crowd_labels_the_most_visible_and_a_room_all():
    owners = np.full((120, 200), -1, dtype=np.int32)
    # 100 things: the first ten have squares of 30 x 30 pixels, the others of 3 x 3.
    for k in range(10):
        owners[:10, 12 * k : 12 * k + 10] = k
    for k in range(10, 100):
        owners[20 + 2 * (k // 10), 4 * (k % 10)] = k
    chosen = most_visible(range(100), owners, STEP_PX)
    assert len(chosen) == 30
    assert set(range(10)) <= set(chosen)
    assert sorted(most_visible(range(20), owners, STEP_PX)) == list(range(20))
    everywhere = np.arange(120 * 200, dtype=np.int32).reshape(120, 200) % 40
    assert sorted(most_visible(range(40), everywhere, STEP_PX)) == list(range(40))
