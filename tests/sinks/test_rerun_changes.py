from dataclasses import replace
import numpy as np
from rerun.components import MeshFaceRendering
from hickory_stream.geometry.lazy_arrays import give_up
from hickory_stream.geometry.voxels import keys_of_cells
from hickory_stream.records import ObservedSpace, SpaceObservation
from hickory_stream.sinks.rerun.objects import ObjectLayers
from hickory_stream.sinks.rerun.structure import FLOOR, WALLS, Structure
from tests.engine.snapshot_fixtures import make_snapshot

SECOND_NS = 1_000_000_000


def unreadable(name):
    raise AssertionError(f"{name} was read")


def shown(folder, snapshot):
    layers = ObjectLayers(folder=folder, max_points=100, cloud_period_ns=SECOND_NS, texture_px=0)
    assert layers.update(snapshot.objects, 0)
    return layers


def test_objects_that_stay_the_same_are_not_looked_at(tmp_path):
    snapshot = make_snapshot()
    layers = shown(tmp_path, snapshot)
    for tracked in snapshot.objects:
        give_up(tracked, unreadable, "points_world", "colors")
    assert layers.update(snapshot.objects, 5 * SECOND_NS) == []
    assert layers.finish() == []


def test_a_cloud_that_grew_is_shown_once_its_time_has_come(tmp_path):
    snapshot = make_snapshot()
    layers = shown(tmp_path, snapshot)
    first, *others = snapshot.objects
    grown = replace(
        first,
        points_world=np.concatenate([first.points_world, first.points_world[:1]]),
        colors=np.concatenate([first.colors, first.colors[:1]]),
    )
    assert layers.update((grown, *others), SECOND_NS // 2) == []
    (item,) = layers.update((grown, *others), 2 * SECOND_NS)
    assert item.path.endswith(f"/{first.id}/points")
    # Another record with the same points is compared once, and then known.
    again = replace(grown)
    assert layers.update((again, *others), 4 * SECOND_NS) == []
    give_up(again, unreadable, "points_world", "colors")
    assert layers.update((again, *others), 6 * SECOND_NS) == []


def test_whoever_comes_late_is_shown_the_whole(tmp_path):
    snapshot = make_snapshot()
    paths = {item.path for item in shown(tmp_path, snapshot).update((), SECOND_NS)}
    assert {path.rpartition("/")[2] for path in paths} == {str(tracked.id) for tracked in snapshot.objects}


def test_structure_is_made_anew_of_submaps_that_changed_alone():
    snapshot = make_snapshot()
    structure = Structure()
    before = structure.items(snapshot)
    for submap in snapshot.submaps:
        give_up(submap.observed_space, unreadable, "free", "structure")
    assert not structure.grown(snapshot, None)
    (floor,) = structure.items(snapshot)
    assert [item.path for item in before] == [FLOOR, f"{WALLS}/0"]
    assert before[0].archetypes[0].positions.as_arrow_array() == floor.archetypes[0].positions.as_arrow_array()


def test_walls_and_floor_are_there_from_the_first_keyframe_on():
    wall = [(50, y, z) for y in range(20) for z in range(6, 30)]
    keys = np.sort(keys_of_cells(np.array(wall + [(x, y, 0) for x in range(50) for y in range(20)])))
    free = np.sort(keys_of_cells(np.array(wall) - (1, 0, 0)))
    seen = SpaceObservation(free_keys=free, structure_keys=keys, floor_z_m=0.02)
    nothing = ObservedSpace(voxel_m=0.05, free=np.empty(0, np.int64), structure=np.empty(0, np.int64), floor_z_m=None)
    first = make_snapshot()
    first = replace(first, submaps=(replace(first.submaps[0], observed_space=nothing),))
    known = replace(nothing, free=free, structure=keys, floor_z_m=0.02)
    second = replace(first, submaps=(replace(first.submaps[0], observed_space=known),))
    structure = Structure()
    for snapshot in (first, second):
        floor, walls = structure.grown(snapshot, seen)
        assert len(floor.archetypes[0].positions.as_arrow_array()) == 50 * 20
        (mesh,) = walls.archetypes
        # Only from where it was seen.
        assert set(map(tuple, mesh.vertex_normals.as_arrow_array().to_pylist())) == {(-1.0, 0.0, 0.0)}
        assert mesh.face_rendering.as_arrow_array().to_pylist() == [MeshFaceRendering.Front.value]
    assert not structure.grown(second, seen)
    few = replace(second, submaps=(replace(second.submaps[0], observed_space=replace(known, structure=keys[:-9])),))
    assert [bool(structure.grown(few, seen)) for _ in range(20)].index(True) == 18
