"""Answers of `diff` about two days of one world and about a run in which things change; passers-by; questions."""
# Rooms (quick: one, two days) and apartments (three days each) of `worlds.days`. A true object is in a map if its match
# at box IoU 0.25 is; a change counts as held by the maps if its objects are in those that can show them.

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hickory_stream.alignment.align import align
from hickory_stream.alignment.answer import Alignment
from hickory_stream.alignment.object_map import object_map
from hickory_stream.changes.compare import compare_maps
from hickory_stream.changes.records import ObjectChange, Verdict
from hickory_stream.config import MapperConfig
from hickory_stream.evaluation.match import meshes_of, score_map
from hickory_stream.evaluation.truth import Truth, load_truth
from hickory_stream.geometry.voxels import contains, dilate
from hickory_stream.map_folder.layout import EMPTY
from hickory_stream.map_folder.saved_map import SavedMap, open_map
from hickory_stream.pictures.raycast import Scene
from hickory_stream.query.answers import ask
from hickory_stream.query.map_index import MapIndex, index_of, neighbours
from hickory_stream.records import Phase
from tools.benchmarks.common.cached_runs import map_without_shapes, state_folder
from tools.benchmarks.common.figures import Figure, Options, figure, share
from tools.benchmarks.common.processes import best_s
from tools.benchmarks.maps.change_counts import PairCounts, calibration_figures, count_figures, counts_of, sum_of
from tools.benchmarks.maps.rendered_views import scene_of
from tools.benchmarks.maps.true_questions import true_questions
from tools.benchmarks.maps.within_run import run_counts
from tools.evaluation.true_changes import TrueChanges, true_changes
from tools.worlds.recording_config import RecordingConfig, person_of, walkable_world

# Nothing was tuned on these seeds, but the roles of the figures say otherwise.
_FIRST_SEED = 4_100
_UNSEEN = 0.02
_QUESTIONS = (
    "something to sit on", "a red box near a table", "how many blue things",
    "the largest thing on the floor and not near the wall", "something beside a chair in front of a table",
)  # fmt: skip
_MANY = 1000
_NUM_QUESTIONS = 300
_RUNS = 3


def measure(options: Options) -> list[Figure]:
    """Return the share of changes that were found, and the time of a question."""
    # `--only days`, `run`, `person` or `questions` measures a part; a quick run leaves out changes within a run and the
    # person.
    parts = options.only or (("days", "questions") if options.quick else ("days", "run", "person", "questions"))
    first = _FIRST_SEED + 10 * options.seed
    state = state_folder(options.state, "changes")
    worlds: list[list[tuple[Truth, SavedMap]]] = []
    if options.scenes:
        worlds = [[(load_truth(folder), open_map(folder.with_suffix(".map"))) for folder in options.scenes]]
    elif "days" in parts or "questions" in parts:
        scene, seeds, days = ("room", 1, 2) if options.quick else ("apartment", 4, 3)
        worlds = [
            [_day(state, scene, seed, day, quick=options.quick) for day in range(days)]
            for seed in range(first, first + seeds)
        ]
    figures: list[Figure] = []
    if "days" in parts or options.scenes:
        figures += _day_figures(
            [pair_counts(*world[i], *world[i + 1]) for world in worlds for i in range(len(world) - 1)]
        )
    if "run" in parts:
        runs = sum_of([run_counts(state, seed) for seed in range(first, first + _RUNS)])
        # The treatment of objects that were not seen since was chosen on the first three.
        role = "" if options.seed else "tuned on"
        figures += [replace(one, role=role) for one in count_figures(runs, "run_")]
    if "person" in parts:
        figures += _person_figures(state, range(first, first + _RUNS))
    if "questions" in parts:
        figures += [*query_figures([made for world in worlds for made in world], _NUM_QUESTIONS), query_ms()]
    return figures


def pair_counts(truth_a: Truth, map_a: SavedMap, truth_b: Truth, map_b: SavedMap) -> PairCounts:
    """Return the answer of `diff` about two maps in the frames of their truths, against the true changes."""
    answer = align(object_map(map_a.snapshot), object_map(map_b.snapshot))
    if not isinstance(answer, Alignment):
        return PairCounts()
    found = compare_maps(map_a.snapshot, map_b.snapshot, answer.a_from_b, answer.translation_sigma_m).changes
    in_a, in_b = (
        {row.truth_id: row.map_id for row in score_map(saved.snapshot, meshes_of(saved), truth).truth if row.counts}
        for saved, truth in ((map_a, truth_a), (map_b, truth_b))
    )
    true = true_changes(truth_a, truth_b)
    of_a = {one.id_a: one for one in found if one.id_a is not None}
    of_b = {one.id_b: one for one in found if one.id_b is not None}
    gone = {i for i, one in of_a.items() if one.verdict in (Verdict.GONE, Verdict.EXCHANGED)}
    new = {i for i, one in of_b.items() if one.verdict in (Verdict.NEW, Verdict.EXCHANGED)}
    moved = {i: one.id_b for i, one in of_a.items() if one.verdict is Verdict.MOVED}
    verdicts = judged(found, true, {m: i for i, m in in_a.items()}, {m: i for i, m in in_b.items()})
    shown_b = {item.id: item.seen_fraction for item in truth_b.objects}
    said_gone = {i for i, one in of_a.items() if one.verdict is Verdict.GONE}
    return replace(
        counts_of(true, (in_a, in_b), gone, moved, new), gone=sum(one.verdict is Verdict.GONE for one in found),
        gone_but_unseen=sum(in_a.get(i) in said_gone and shown_b[i] < _UNSEEN for i in true.stayed), said=len(verdicts),
        said_right=sum(right for _, right in verdicts), probability=sum(sure for sure, _ in verdicts),
        brier=sum((sure - right) ** 2 for sure, right in verdicts),
    )  # fmt: skip


def judged(
    found: Sequence[ObjectChange], true: TrueChanges, true_a: Mapping[int | None, int], true_b: Mapping[int | None, int]
) -> list[tuple[float, bool]]:
    """Return probability and truth of each verdict about a true object; `true_*` are these, by map id."""
    verdicts = []
    for one in found:
        a = None if one.id_a is None else true_a.get(one.id_a)
        b = None if one.id_b is None else true_b.get(one.id_b)
        match one.verdict:
            case Verdict.STILL_THERE:
                right = (a if a is not None else b) in true.stayed and (a is None or b is None or a == b)
            case Verdict.MOVED:
                right = a in true.moved and a == b
            case Verdict.GONE:
                right = a in true.gone or a in true.moved
            case Verdict.NEW:
                right = b in true.new or b in true.moved
            case Verdict.EXCHANGED:
                right = a in true.gone and b in true.new
            case _:
                continue
        if a is not None or b is not None:
            verdicts.append((one.probability, right))
    return verdicts


def query_figures(made: Sequence[tuple[Truth, SavedMap]], count: int) -> list[Figure]:
    """Return how often the first answer is right: of all questions, and of those whose objects the map holds."""
    # A question without an answer is answered rightly by none.
    rows: list[tuple[bool, bool]] = []
    for k, (truth, saved) in enumerate(made):
        scored = score_map(saved.snapshot, meshes_of(saved), truth).truth
        true_of = {row.map_id: row.truth_id for row in scored if row.map_id is not None}
        index = index_of(saved.snapshot, MapperConfig().mapping)
        for question in true_questions(truth, count // len(made), np.random.default_rng([_FIRST_SEED, k])):
            first = ask(index, question.text).found[:1]
            answer = true_of.get(first[0].id) if first else None
            is_right = answer in question.answers if question.answers else not first
            rows.append((is_right, question.is_held(set(true_of.values()))))
    right, held = (sum(column) for column in zip(*rows, strict=True))
    both = sum(is_right and is_held for is_right, is_held in rows)
    return [
        *share("query_precision_at_1", both, held, "questions that the map has the objects for, or nobody"),
        *share("query_precision_at_1_of_all", right, len(rows), "questions, whatever the map lacks"),
    ]


def query_ms() -> Figure:
    """Return the processor time of a question to 1,000 objects of random attributes, in a hall of 40 x 40 m."""
    index = many_objects(_MANY)

    def three(text: str) -> None:
        for _ in range(3):
            ask(index, text)

    took_ms = []
    for text in _QUESTIONS:
        ask(index, text)
        took_ms.append(1000 * best_s(lambda text=text: three(text), 1) / 3)
    of = f"the slowest of {len(_QUESTIONS)} questions, {_MANY} objects, processor time; the index is made before"
    return figure("query_ms", max(took_ms), "ms", "lower", of)


def many_objects(count: int) -> MapIndex:
    """Return the index of a map of so many random objects, a third of which stand on others."""
    rng = np.random.default_rng(0)
    empty = index_of(EMPTY, MapperConfig().mapping)
    sides = np.sort(rng.uniform(0.1, 1.5, (count, 3)), axis=1)[:, [2, 1, 0]]
    centers = np.c_[rng.uniform(-20, 20, (count, 2)), sides[:, 2] / 2]
    lows, highs = centers - sides / 2, centers + sides / 2
    return MapIndex(
        ids=np.arange(count), centers=centers, lows=lows, highs=highs, sides_m=sides, bottom_m=lows[:, 2],
        colors=rng.dirichlet(np.full(empty.colors.shape[1], 0.2), count),
        shapes=rng.random((count, empty.shapes.shape[1])),
        levels_m2=rng.random((count, empty.levels_m2.shape[1])) * 0.1,
        held_by=np.where(rng.random(count) < 0.3, rng.integers(0, count, count), -1),
        is_at_wall=rng.random(count) < 0.3, seen_from=np.c_[rng.uniform(-20, 20, (count, 2)), np.ones(count)],
        pairs=neighbours(lows[:, :2], highs[:, :2]), fixed=rng.random(count),
    )  # fmt: skip


def _day(state: Path, scene: str, seed: int, day: int, *, quick: bool) -> tuple[Truth, SavedMap]:
    size: dict[str, Any] = (
        {"width": 480, "height": 270, "rate_hz": 4.0, "seconds": 16.0} if quick else {"seconds": None}
    )
    config = RecordingConfig(scene=scene, seed=seed, walk_index=day % 2, day=day, **size)
    return map_without_shapes(config, state / f"{scene}-{seed}-{day}{'-quick' if quick else ''}.map")


def _day_figures(pairs: Sequence[PairCounts]) -> list[Figure]:
    total = sum_of(pairs)
    return [
        *count_figures(total),
        *share("days_aligned_fraction", total.aligned, len(pairs), "pairs of days"),
        figure("gone_but_unseen", total.gone_but_unseen, "", "lower", f"{total.gone} gone"),
        *calibration_figures(total),
    ]


def _person_figures(state: Path, seeds: Sequence[int]) -> list[Figure]:
    rooms = [passer_by(state, "room", seed, 30.0) for seed in seeds]
    names = ("objects", "person_objects", "held", "lost", "structure", "structure_lost")
    objects, made, held, lost, structure, gone = (sum(getattr(one, name) for one in rooms) for name in names)
    of = f"{objects} objects of the maps of {len(rooms)} rooms in which a person walks"
    return [
        figure("person_objects", made, "", "lower", of),
        *share("person_objects_lost", lost, held, "true objects found without the person", "lower"),
        *share("person_structure_lost", gone, structure, "voxels of structure without the person", "lower"),
    ]


# Traces of a person who walks through a room in its map, against the map of the same walk without the person.
# An object is made of the person if at least half of its points lie off every true surface, at a place of the person.
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
