from dataclasses import replace
import numpy as np
from hickory_stream.alignment.align import align
from hickory_stream.alignment.object_map import object_map
from hickory_stream.changes.page import COLORS, Footprint, plan_svg
from hickory_stream.changes.records import Verdict
from hickory_stream.geometry.display import color_of_id
from hickory_stream.geometry.mesh import mesh_of_glb, sha256_of, write_glb
from hickory_stream.map_folder.saved_map import open_map
from hickory_stream.map_folder.writer import create_map_folder
from hickory_stream.navigation.free_space import free_space_of
from hickory_stream.navigation.robot import load_robot
from hickory_stream.navigation.search import NoPath, NoPathReason
from hickory_stream.pictures.labels import flat_labels
from hickory_stream.pictures.legend import GENERATED, legend_of, with_tint, with_tinted_image
from hickory_stream.pictures.render import render_map
from hickory_stream.pictures.render_alignment import alignment_meanings, render_alignment
from hickory_stream.pictures.render_navigation import render_plan
from hickory_stream.textures.textured_mesh import TexturedMesh
from tests.alignment.map_fixtures import frame, furniture, snapshot_of
from tests.engine.snapshot_fixtures import box_mesh, make_snapshot
from tests.navigation.rooms import snapshot, table, tracked


def colors_in(image):
    return set(map(tuple, image.reshape(-1, 3).tolist()))


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
