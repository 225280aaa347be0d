import json
from dataclasses import replace
import numpy as np
import pytest
from hickory_stream.cli import main
from hickory_stream.config import RunConfig
from hickory_stream.geometry.boxes import gravity_aligned_box
from hickory_stream.geometry.rigid import apply, invert
from hickory_stream.map_folder.array_files import unpacked
from hickory_stream.map_folder.saved_map import open_map
from hickory_stream.map_folder.views import read_crop
from hickory_stream.map_folder.writer import create_map_folder
from hickory_stream.merging.clusters import Pairing, Place, clusters_of
from hickory_stream.merging.merge_maps import merge_maps
from tests.alignment.map_fixtures import cloud, frame, furniture, snapshot_of
from tests.engine.snapshot_fixtures import make_snapshot

ITEMS = furniture(16, 7)
B_FROM_WORLD, C_FROM_WORLD = frame(70, 2, -1), frame(-130, 0.5, 3)


@pytest.fixture(scope="module")
def three():
    """Three maps of one place: 12 objects, 12 of which 8 are the first one's, and 12 others that overlap both."""
    return [
        snapshot_of(ITEMS[:12], np.eye(4), 1),
        snapshot_of(ITEMS[4:], B_FROM_WORLD, 2),
        snapshot_of([*ITEMS[:3], *ITEMS[7:]], C_FROM_WORLD, 3),
    ]


def place(center, half, rng):
    points = cloud(center, half, rng)
    return Place(points=points, box=gravity_aligned_box(points, 0.005))


def save(path, snapshot):
    folder = create_map_folder(path, config={}, source={"uri": path.name})
    folder.save(snapshot)
    folder.finish(finished_cleanly=True)
    return path


def test_three_maps_become_one_with_every_object_once(three):
    merged = merge_maps(three)
    assert merged.left_out == ()
    assert all(pair.is_believed for pair in merged.pairs)
    assert len(merged.snapshot.objects) == 16
    for pose, true in zip(merged.world_from_map, (np.eye(4), B_FROM_WORLD, C_FROM_WORLD), strict=True):
        assert np.allclose(pose, invert(true), atol=0.02)
    places = np.array([place for place, _, _ in ITEMS])
    for tracked in merged.snapshot.objects:
        assert np.linalg.norm(places - tracked.box.center, axis=1).min() < 0.05


def test_every_object_knows_where_it_came_from(three):
    merged = merge_maps(three)
    members = sorted(member for group in merged.provenance.values() for member in group)
    assert members == [(i, k) for i in range(3) for k in range(1, 13)]
    # Object 5 of the first map is object 1 of the second; both missing in the third.
    assert merged.provenance[5] == ((0, 5), (1, 1))
    assert sorted(merged.provenance) == [tracked.id for tracked in merged.snapshot.objects]
    assert next(tracked for tracked in merged.snapshot.objects if tracked.id == 5).sightings == 10


def test_the_inputs_and_observed_space_are_not_changed(three):
    before = [tracked.points_world.tobytes() for snapshot in three for tracked in snapshot.objects]
    merged = merge_maps(three)
    assert before == [tracked.points_world.tobytes() for snapshot in three for tracked in snapshot.objects]
    assert [submap.id for submap in merged.snapshot.submaps] == [0, 1, 2]
    for submap, snapshot in zip(merged.snapshot.submaps, three, strict=True):
        assert submap.observed_space is snapshot.submaps[0].observed_space


def test_a_map_of_another_place_is_left_out(three):
    merged = merge_maps([*three[:2], snapshot_of(furniture(12, 99), np.eye(4))])
    assert merged.left_out == (2,)
    assert [(pair.a, pair.b) for pair in merged.pairs if pair.is_believed] == [(0, 1)]


def test_if_the_first_map_is_alone_the_second_gives_the_frame(three):
    merged = merge_maps([snapshot_of(furniture(12, 99), np.eye(4)), *three[1:]])
    assert merged.left_out == (0,)
    assert np.allclose(merged.world_from_map[1], np.eye(4), atol=1e-6)
    assert np.allclose(merged.world_from_map[2], B_FROM_WORLD @ invert(C_FROM_WORLD), atol=0.02)
    assert {i for group in merged.provenance.values() for i, _ in group} == {1, 2}
    assert [(pair.a, pair.b) for pair in merged.pairs if pair.is_believed] == [(1, 2)]


def test_a_cluster_has_one_object_of_each_map():
    rng = np.random.default_rng(0)
    half = np.full(3, 0.2)
    members = [(0, 1), (0, 2), (1, 1), (1, 2), (2, 5)]
    spots = {(0, 1): 0.0, (0, 2): 3.0, (1, 1): 0.0, (1, 2): 6.0, (2, 5): 6.0}
    places = {member: place(np.array([x, 0, 0]), half, rng) for member, x in spots.items()}
    pairings = [
        Pairing(a=(0, 1), b=(1, 1), residual_m=0.01),
        # Worse, and it would put two objects of map 0 into one.
        Pairing(a=(0, 2), b=(1, 1), residual_m=0.2),
    ]
    assert clusters_of(members, pairings, places, 0.5) == [((0, 1), (1, 1)), ((0, 2),), ((1, 2), (2, 5))]


def test_one_object_does_not_replace_several_of_another_map():
    rng = np.random.default_rng(0)
    lying = {(0, i): place(np.array([0.6 * i, 0, 0]), np.full(3, 0.2), rng) for i in range(3)}
    whole = np.concatenate([one.points for one in lying.values()])
    places = {**lying, (1, 5): Place(points=whole, box=gravity_aligned_box(whole, 0.005))}
    pairings = [Pairing(a=(0, 1), b=(1, 5), residual_m=0.01)]
    assert clusters_of(list(places), pairings, places, 0.5) == [((0, 0),), ((0, 1),), ((0, 2),), ((1, 5),)]
    # Two are what one thing may break into.
    del places[0, 2]
    assert clusters_of(list(places), pairings, places, 0.5) == [((0, 0),), ((0, 1), (1, 5))]


def test_merge_writes_a_map_that_opens_and_names_its_sources(three, tmp_path, capsys):
    paths = [save(tmp_path / name, snapshot) for name, snapshot in zip("abc", three, strict=True)]
    digests = [open_map(path).manifest.digest for path in paths]
    assert main(["merge", *map(str, paths), "-o", str(tmp_path / "m"), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["objects"] == 16
    assert told["left_out"] == []
    saved = open_map(tmp_path / "m")
    assert saved.manifest.finished_cleanly
    assert len(saved.snapshot.objects) == 16
    assert [entry["digest"] for entry in saved.manifest.source["maps"]] == digests
    assert saved.manifest.source["provenance"]["5"] == [[0, 5], [1, 1]]
    assert [open_map(path).manifest.digest for path in paths] == digests
    # The same maps give the same merged map.
    assert main(["merge", *map(str, paths), "-o", str(tmp_path / "n"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["digest"] == told["digest"]


def test_views_and_meshes_move_along_under_names_of_their_own(tmp_path):
    paths = []
    lossy = RunConfig(view_colors="jpeg")
    for name, pose, views_as in (("a", np.eye(4), RunConfig()), ("b", B_FROM_WORLD, lossy)):
        folder = create_map_folder(tmp_path / name, config={}, source={"uri": name})
        real = make_snapshot(folder, views_as=views_as)
        base = snapshot_of(ITEMS[:10], pose)
        # A table with mesh and views of its own in both maps, far from everything else.
        offset = 20
        tables = tuple(replace(item, id=item.id + offset) for item in real.objects[:1])
        folder.save(replace(base, objects=base.objects + tables))
        folder.finish(finished_cleanly=True)
        paths.append(tmp_path / name)
    assert main(["merge", *map(str, paths), "-o", str(tmp_path / "m")]) == 0
    saved, first = open_map(tmp_path / "m"), open_map(paths[0])
    with_views = [tracked for tracked in saved.snapshot.objects if tracked.views]
    assert with_views
    names = [view.name for tracked in with_views for view in tracked.views]
    assert len(names) == len(set(names))
    kinds = set()
    for tracked in with_views:
        for view in tracked.views:
            stored = unpacked((saved.views / f"{view.name}.view").read_bytes())
            kinds |= stored.keys() & {"rgb", ".jpg"}
            read_crop(saved.views, view.name)
        if tracked.shape is not None:
            assert len(saved.mesh(tracked.shape).vertices) > 0
    assert kinds == {"rgb", ".jpg"}
    table = next(tracked for tracked in first.snapshot.objects if tracked.views)
    mine = next(tracked for tracked in saved.snapshot.objects if tracked.id == table.id)
    assert np.allclose(
        apply(np.eye(4), mine.views[0].world_from_camera[:3, 3]), table.views[0].world_from_camera[:3, 3]
    )


def test_maps_of_different_places_are_not_merged(tmp_path, capsys):
    a = save(tmp_path / "a", snapshot_of(ITEMS[:10], np.eye(4)))
    b = save(tmp_path / "b", snapshot_of(furniture(10, 55), np.eye(4)))
    assert main(["merge", str(a), str(b), "-o", str(tmp_path / "m")]) == 3
    told = capsys.readouterr().out
    assert told.endswith("nothing was merged\n")
    assert "left out" not in told
    assert not (tmp_path / "m").exists()


def test_merge_refuses_one_map_and_a_result_that_is_an_input(tmp_path, capsys):
    a, b = (save(tmp_path / name, snapshot_of(ITEMS[:4], np.eye(4))) for name in "ab")
    assert main(["merge", str(a), "-o", str(tmp_path / "m")]) == 2
    assert "at least two" in capsys.readouterr().err
    assert main(["merge", str(a), str(b), f"{b}/", "-o", str(tmp_path / "m")]) == 2
    assert "b is given twice" in capsys.readouterr().err
    assert main(["merge", str(a), str(b), "-o", str(a)]) == 2
    assert "is one of the inputs; choose another folder" in capsys.readouterr().err
