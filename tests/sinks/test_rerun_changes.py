"""What has not changed since it was shown is neither shown again nor looked at: its arrays cannot even be read here."""

from dataclasses import replace
from pathlib import Path
from typing import Any
import numpy as np
from hickory_stream.geometry.lazy_arrays import give_up
from hickory_stream.records import MapSnapshot
from hickory_stream.sinks.rerun.objects import ObjectLayers
from hickory_stream.sinks.rerun.structure import Structure
from tests.engine.snapshot_fixtures import make_snapshot

SECOND_NS = 1_000_000_000


def unreadable(name: str) -> Any:
    raise AssertionError(f"{name} was read")


def shown(folder: Path, snapshot: MapSnapshot) -> ObjectLayers:
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
    after = structure.items(snapshot)
    for a, b in zip(before, after, strict=True):
        assert a.archetypes[0].positions.as_arrow_array() == b.archetypes[0].positions.as_arrow_array()
