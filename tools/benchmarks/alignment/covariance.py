"""The calibration of alignment's covariance on maps of the whole pipeline: the squared error by its covariance."""
# Parts of two mapped walks are aligned, one turned, shifted and tilted by 0 to 3 degrees. The true place of a part
# follows from the true poses of the camera around it: a map that drifts is not rigid.

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from hickory_stream.alignment.align import align
from hickory_stream.alignment.answer import Alignment
from hickory_stream.alignment.object_map import ObjectMap, object_map, taken
from hickory_stream.evaluation.truth import load_truth
from hickory_stream.geometry.rigid import apply, compose, from_rotation_translation, invert, rotation_of_vector
from players import open_source
from tools.benchmarks.alignment.ambiguous import CHI2_95, TILTS_DEG
from tools.benchmarks.common.cached_runs import cached_map, state_folder
from tools.benchmarks.common.figures import Figure, Options, figure, share
from tools.benchmarks.common.intervals import bootstrap
from tools.benchmarks.poses.drift import CONFIG, keyframe_poses
from tools.benchmarks.poses.drift_logs import FACTORS, drifting_walks, second_walks
from tools.evaluation.alignment_table import error_of
from tools.evaluation.simulated_maps.trial import normalised_square
from tools.evaluation.simulated_maps.variants import moved_map, random_frame

_TRIALS = 40
_REACH_M = (2.5, 6.0)
_LEAST_POSES = 8
_EVERYWHERE = 1e9


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class WalkMap:
    """A map, and the poses (K, 4, 4) of its K keyframes, in the map and true."""

    objects: ObjectMap
    found: NDArray[np.float64]
    true: NDArray[np.float64]

    def map_from_world(self, place: NDArray[np.float64], reach_m: float) -> NDArray[np.float64]:
        """Return the pose of the world in the map (4, 4) by the keyframes near a place (3,) of the map."""
        away = np.linalg.norm(self.found[:, :2, 3] - place[:2], axis=1)
        near = np.flatnonzero(away < reach_m)
        near = near if len(near) >= _LEAST_POSES else np.argsort(away, kind="stable")[:_LEAST_POSES]
        found, true = self.found[near], self.true[near]
        turns = found[:, :3, :3] @ np.swapaxes(true[:, :3, :3], 1, 2)
        turn = Rotation.from_matrix(turns).mean().as_matrix()
        return from_rotation_translation(turn, (found[:, :3, 3] - true[:, :3, 3] @ turn.T).mean(axis=0))


@dataclass(frozen=True, kw_only=True, slots=True)
class Squares:
    """Right answers of a pair of maps by their normalised squared errors; how many were refused, and how many wrong."""

    squares: tuple[float, ...]
    refused: int
    wrong: int


def square_figures(options: Options) -> list[Figure]:
    """Return how the errors of alignments of whole maps fit their covariances; maps that are not cached are played."""
    folder = state_folder(options.state, "squares")
    pairs: dict[str, list[Squares]] = {"own": [], "foreign": [], "drifting": []}
    for walk, second in zip(drifting_walks(options), second_walks(options), strict=True):
        path = folder / f"{walk.name}-{second.key}-second.map"
        cached_map(path, lambda log=second.log: open_source(str(log)), *CONFIG)
        other = walk_map(path, second.truth)
        for factor in (0.0, *FACTORS):
            path = folder / f"{walk.name}-{walk.log.key}-{factor:g}.map"
            cached_map(path, lambda walk=walk, factor=factor: walk.open(factor), *CONFIG)
            found = squares_of(walk_map(path, walk.log.truth), other, seed=options.seed)
            print(
                f"{walk.name}, drift {factor:g}: mean square {np.mean(found.squares or [np.nan]):.2f}, "
                f"{len(found.squares)} aligned, {found.refused} refused, {found.wrong} wrong",
                flush=True,
            )
            pairs["drifting" if factor else "own" if walk.name.startswith("own") else "foreign"].append(found)
    return [one for kind, found in pairs.items() if any(one.squares for one in found) for one in _of_kind(kind, found)]


def walk_map(path: Path, truth: Path) -> WalkMap:
    """Return a map folder with the true poses of its keyframes."""
    saved, poses = keyframe_poses(path)
    true = {frame.stamp_ns: frame.world_from_camera for frame in load_truth(truth).frames}
    stamps_ns = sorted(set(poses) & set(true))
    return WalkMap(
        objects=object_map(saved.snapshot, saved.manifest.extractor),
        found=np.array([poses[stamp_ns] for stamp_ns in stamps_ns]),
        true=np.array([true[stamp_ns] for stamp_ns in stamps_ns]),
    )


def squares_of(one: WalkMap, other: WalkMap, *, seed: int, trials: int = _TRIALS) -> Squares:
    """Return the result of aligning parts of a map with those of another one, which is moved and tilted."""
    middle = np.zeros(3)
    about = compose(one.map_from_world(middle, _EVERYWHERE), invert(other.map_from_world(middle, _EVERYWHERE)))
    there = moved_map(other.objects, about)
    squares, refused, wrong = [], 0, 0
    for i in range(trials):
        rng = np.random.default_rng([seed, i])
        place, reach_m = one.objects.centroids[rng.integers(len(one.objects))], rng.uniform(*_REACH_M)
        moved = _tilted(rng, TILTS_DEG[i % len(TILTS_DEG)])
        answer = align(_near(one.objects, place, reach_m), moved_map(_near(there, place, reach_m), moved))
        if not isinstance(answer, Alignment):
            refused += 1
            continue
        here = one.map_from_world(answer.center_a, reach_m)
        world_from_there = invert(other.map_from_world(apply(invert(about), answer.center_a), reach_m))
        true = compose(here, world_from_there, invert(about), invert(moved))
        if error_of(answer.a_from_b, true, apply(invert(true), answer.center_a)).is_success:
            squares.append(normalised_square(answer, true))
        else:
            wrong += 1
    return Squares(squares=tuple(squares), refused=refused, wrong=wrong)


def _near(objects: ObjectMap, place: NDArray[np.float64], reach_m: float) -> ObjectMap:
    away = np.linalg.norm(objects.centroids[:, :2] - place[:2], axis=1)
    return taken(objects, np.flatnonzero(away < reach_m))


def _tilted(rng: np.random.Generator, tilt_deg: float) -> NDArray[np.float64]:
    heading = rng.uniform(0, 2 * np.pi)
    tilt = np.radians(tilt_deg) * np.array([np.cos(heading), np.sin(heading), 0.0])
    return compose(from_rotation_translation(rotation_of_vector(tilt), np.zeros(3)), random_frame(rng))


def _of_kind(kind: str, found: Sequence[Squares]) -> list[Figure]:
    groups = [np.array(one.squares) for one in found]
    squares = np.concatenate(groups)
    refused, wrong = sum(one.refused for one in found), sum(one.wrong for one in found)
    of = f"parts of {len(found)} pairs of maps, 6 dof; {refused} refused, {wrong} wrong"
    interval = bootstrap(groups, lambda drawn: float(np.concatenate(drawn).mean()))
    more = {"interval": interval, "interval_by": "bootstrap over parts, which overlap", "role": "tuned on"}
    within = int((squares < CHI2_95).sum())
    return [
        figure(f"nees_mean_{kind}_maps", squares.mean(), "", "same", f"{len(squares)} {of}", **more),
        *share(f"nees_within_95_{kind}_maps", within, len(squares), of, role="tuned on"),
    ]
