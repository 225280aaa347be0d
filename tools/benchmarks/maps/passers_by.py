"""Traces of a person who walks through a room in its map, against the map of the same walk without the person."""
# An object is made of the person if at least half of its points lie off every true surface, at a place of the person.

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hickory_stream.evaluation.match import score_map
from hickory_stream.geometry.voxels import contains, dilate
from hickory_stream.map_folder.saved_map import SavedMap
from hickory_stream.pictures.raycast import Scene
from hickory_stream.records import Phase
from tools.benchmarks.common.cached_runs import map_without_shapes
from tools.benchmarks.maps.rendered_views import scene_of
from tools.worlds.recording_config import RecordingConfig, person_of, walkable_world

_OFF_M = 0.05
_REACH_M = 0.45
_POINTS = 400


@dataclass(frozen=True, kw_only=True, slots=True)
class PasserBy:
    """Of one room: objects of the final map, those made of the person, and true objects and structure held or lost."""

    objects: int = 0
    person_objects: int = 0
    held: int = 0
    lost: int = 0
    structure: int = 0
    structure_lost: int = 0


def passer_by(state: Path, scene: str, seed: int, seconds: float | None) -> PasserBy:
    """Return the counts of a walk through a room in which a person walks about."""
    alone = RecordingConfig(scene=scene, seed=seed, seconds=seconds, rate_hz=4.0, width=480, height=270)
    config = replace(alone, person=True)
    (truth, without), (_, with_person) = (
        map_without_shapes(one, state / f"{scene}-{seed}-{name}.map")
        for one, name in ((alone, "alone"), (config, "person"))
    )
    person = person_of(walkable_world(config)[0], config)
    assert person is not None, f"no person can walk through {scene} {seed}"
    stamps_ns = np.array([frame.stamp_ns for frame in truth.frames])
    places_m = np.array([person.model_at(float(s))[1][:2, 3] for s in (stamps_ns - stamps_ns[0]) / 1e9])
    true_scene = scene_of(truth)
    objects = [item for item in with_person.snapshot.objects if item.phase is not Phase.TENTATIVE]
    found_alone, found = (
        {row.truth_id for row in score_map(saved.snapshot, {}, truth).truth if row.counts and row.map_id is not None}
        for saved in (without, with_person)
    )
    structure, remaining = (_structure(saved) for saved in (without, with_person))
    return PasserBy(
        objects=len(objects),
        person_objects=sum(is_of_person(item.points_world, true_scene, places_m) for item in objects),
        held=len(found_alone),
        lost=len(found_alone - found),
        structure=len(structure),
        structure_lost=int((~contains(dilate(remaining), structure)).sum()),
    )


def is_of_person(points: NDArray[np.float32], true_scene: Scene, places_m: NDArray[np.float64]) -> bool:
    """Return whether points (N, 3) are those of a person who was at `places_m` (F, 2), not of any true surface."""
    some = points[:: max(1, len(points) // _POINTS)].astype(np.float64)
    off_m, _ = true_scene.nearest(some)
    away_m = np.linalg.norm(some[:, None, :2] - places_m[None], axis=2).min(axis=1)
    return bool(((off_m > _OFF_M) & (away_m < _REACH_M)).mean() >= 0.5)


def _structure(saved: SavedMap) -> NDArray[np.int64]:
    return np.unique(np.concatenate([submap.observed_space.structure for submap in saved.snapshot.submaps]))
