"""What `diff` says of two maps of one world on two days, and of a run in which things change; passers-by; questions.

Rooms (quick: one, two days) and apartments (three days each) of `worlds.days`. A true object is in a map if its match
at box IoU 0.25 is; a change counts as held by the maps if the objects that it concerns are in those that can show them.
"""

from __future__ import annotations

import time
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from hickory_stream.alignment.align import align
from hickory_stream.alignment.answer import Alignment
from hickory_stream.alignment.object_map import object_map
from hickory_stream.changes.compare import compare_maps
from hickory_stream.changes.records import Verdict
from hickory_stream.config import MapperConfig
from hickory_stream.evaluation.match import meshes_of, score_map
from hickory_stream.evaluation.truth import load_truth
from hickory_stream.map_folder.layout import EMPTY
from hickory_stream.map_folder.saved_map import open_map
from hickory_stream.query.answers import ask
from hickory_stream.query.map_index import MapIndex, index_of, neighbours
from tools.benchmarks.change_counts import PairCounts, calibration_figures, count_figures, share, sum_of
from tools.benchmarks.changed_maps import mapped
from tools.benchmarks.changed_runs import run_counts
from tools.benchmarks.figures import Figure
from tools.benchmarks.kept import state_folder
from tools.benchmarks.passers_by import passer_by
from tools.benchmarks.true_questions import true_questions
from tools.evaluation.true_changes import true_changes
from tools.worlds.recording_config import RecordingConfig

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from hickory_stream.changes.records import ObjectChange
    from hickory_stream.evaluation.truth import Truth
    from hickory_stream.map_folder.saved_map import SavedMap
    from tools.benchmarks.figures import Options
    from tools.benchmarks.passers_by import PasserBy
    from tools.evaluation.true_changes import TrueChanges

# Nothing was tuned on these seeds, nor on any others, but what `measure` names.
_FIRST_SEED = 4_100
_CHANGED = (Verdict.MOVED, Verdict.GONE, Verdict.NEW, Verdict.EXCHANGED)
_UNSEEN = 0.02
_QUESTIONS = (
    "something to sit on",
    "a red box near a table",
    "how many blue things",
    "the largest thing on the floor and not near the wall",
    "something beside a chair in front of a table",
)
_MANY = 1000
_NUM_QUESTIONS = 300
_RUNS = 3


def measure(options: Options) -> list[Figure]:
    """Return how many changes were found, and how long a question takes.

    `--only days`, `run`, `person` or `questions` measures a part; a quick run leaves out changes within a run and the
    person.
    """
    parts = options.only or (("days", "questions") if options.quick else ("days", "run", "person", "questions"))
    first = _FIRST_SEED + 10 * options.seed
    state = state_folder(options.state, "changes")
    figures: list[Figure] = []
    made: list[tuple[Truth, SavedMap]] = []
    if options.scenes:
        made = [(load_truth(folder), open_map(folder.with_suffix(".map"))) for folder in options.scenes]
        figures += _day_figures(_of_days(made))
    elif "days" in parts or "questions" in parts:
        scene, seeds, days = ("room", 1, 2) if options.quick else ("apartment", 4, 3)
        pairs: list[PairCounts] = []
        for seed in range(first, first + seeds):
            world = [_day(state, scene, seed, day, quick=options.quick) for day in range(days)]
            pairs += _of_days(world)
            made += world
        figures += _day_figures(pairs) if "days" in parts else []
    if "run" in parts:
        runs = sum_of([run_counts(state, seed) for seed in range(first, first + _RUNS)])
        # What is said of objects that were not seen since was found by looking at the first three.
        role = "" if options.seed else "tuned on"
        figures += [replace(figure, role=role) for figure in count_figures(runs, "run_")]
    if "person" in parts:
        figures += _person_figures([passer_by(state, "room", seed, 30.0) for seed in range(first, first + _RUNS)])
    if "questions" in parts:
        figures += [*query_figures(made, _NUM_QUESTIONS), query_ms()]
    return figures


def _of_days(made: Sequence[tuple[Truth, SavedMap]]) -> list[PairCounts]:
    return [pair_counts(*made[i], *made[i + 1]) for i in range(len(made) - 1)]


def pair_counts(truth_a: Truth, map_a: SavedMap, truth_b: Truth, map_b: SavedMap) -> PairCounts:
    """Return what `diff` says of two maps in the frame of their truths, against what changed."""
    answer = align(object_map(map_a.snapshot), object_map(map_b.snapshot))
    if not isinstance(answer, Alignment):
        return PairCounts()
    told = compare_maps(map_a.snapshot, map_b.snapshot, answer.a_from_b, answer.translation_sigma_m).changes
    in_a, in_b = (
        {row.truth_id: row.map_id for row in score_map(saved.snapshot, meshes_of(saved), truth).truth if row.counts}
        for saved, truth in ((map_a, truth_a), (map_b, truth_b))
    )
    true = true_changes(truth_a, truth_b)
    of_a = {one.id_a: one for one in told if one.id_a is not None}
    of_b = {one.id_b: one for one in told if one.id_b is not None}

    def says(i: int | None, side: dict[Any, Any], *verdicts: Verdict) -> bool:
        return i is not None and i in side and side[i].verdict in verdicts

    rows: list[tuple[bool, bool]] = []
    as_moved = 0
    moved_held = 0
    for i in true.moved:
        if i not in in_a or i not in in_b:
            continue
        a, b = in_a[i], in_b[i]
        is_held = a is not None and b is not None
        is_moved = says(a, of_a, Verdict.MOVED) and of_a[a].id_b == b
        apart = says(a, of_a, Verdict.GONE, Verdict.EXCHANGED) and says(b, of_b, Verdict.NEW, Verdict.EXCHANGED)
        rows.append((is_held, is_moved or apart))
        moved_held += is_held
        as_moved += is_moved
    rows += [
        (in_a[i] is not None, says(in_a[i], of_a, Verdict.GONE, Verdict.EXCHANGED)) for i in true.gone if i in in_a
    ]
    rows += [(in_b[i] is not None, says(in_b[i], of_b, Verdict.NEW, Verdict.EXCHANGED)) for i in true.new if i in in_b]
    stayed = [i for i in true.stayed if in_a.get(i) is not None or in_b.get(i) is not None]
    wrong = sum(says(in_a.get(i), of_a, *_CHANGED) or says(in_b.get(i), of_b, *_CHANGED) for i in stayed)
    verdicts = judged(told, true, {m: i for i, m in in_a.items()}, {m: i for i, m in in_b.items()})
    shown_b = {item.id: item.seen_fraction for item in truth_b.objects}
    unseen = sum(says(in_a.get(i), of_a, Verdict.GONE) and shown_b[i] < _UNSEEN for i in true.stayed)
    return PairCounts(
        changes=len(rows), found=sum(found for _, found in rows),
        held=sum(held for held, _ in rows), held_found=sum(held and found for held, found in rows),
        moved_held=moved_held, moved_as_moved=as_moved, objects=len(stayed), false_changes=wrong,
        gone=sum(one.verdict is Verdict.GONE for one in told), gone_but_unseen=unseen, aligned=1,
        said=len(verdicts), said_right=sum(right for _, right in verdicts),
        probability=sum(sure for sure, _ in verdicts), brier=sum((sure - right) ** 2 for sure, right in verdicts),
    )  # fmt: skip


def judged(
    told: Sequence[ObjectChange], true: TrueChanges, true_a: dict[int | None, int], true_b: dict[int | None, int]
) -> list[tuple[float, bool]]:
    """Return probability and truth of each verdict on an object that is a true one; `true_*` are these, by map id."""
    found = []
    for one in told:
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
            found.append((one.probability, right))
    return found


def query_figures(made: Sequence[tuple[Truth, SavedMap]], count: int) -> list[Figure]:
    """Return how often the first answer is right: of all questions, and of those that the map has the objects for.

    A question without an answer is answered rightly by none.
    """
    right, right_held, num, held = 0, 0, 0, 0
    for k, (truth, saved) in enumerate(made):
        found = score_map(saved.snapshot, meshes_of(saved), truth).truth
        true_of = {row.map_id: row.truth_id for row in found if row.map_id is not None}
        index = index_of(saved.snapshot, MapperConfig().mapping)
        for question in true_questions(truth, count // len(made), np.random.default_rng([_FIRST_SEED, k])):
            first = ask(index, question.text).found[:1]
            told = true_of.get(first[0].id) if first else None
            is_right = told in question.answers if question.answers else not first
            is_held = question.is_held(set(true_of.values()))
            num, right = num + 1, right + is_right
            held, right_held = held + is_held, right_held + (is_right and is_held)
    shares = (
        share("query_precision_at_1", right_held, held, "questions that the map has the objects for, or nobody"),
        share("query_precision_at_1_of_all", right, num, "questions, whatever the map lacks"),
    )
    return [figure for figure in shares if figure is not None]


def query_ms() -> Figure:
    """Return the processor time of a question to 1,000 objects of random attributes, in a hall of 40 x 40 m."""
    index = many_objects(_MANY)
    took = []
    for text in _QUESTIONS:
        ask(index, text)
        started = time.process_time()
        for _ in range(3):
            ask(index, text)
        took.append(1000 * (time.process_time() - started) / 3)
    return Figure(
        name="query_ms", value=max(took), unit="ms", better="lower",
        of=f"the slowest of {len(_QUESTIONS)} questions, {_MANY} objects, processor time; the index is made before",
    )  # fmt: skip


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
        pairs=neighbours(lows[:, :2], highs[:, :2]),
    )  # fmt: skip


def _day(state: Path, scene: str, seed: int, day: int, *, quick: bool) -> tuple[Truth, SavedMap]:
    """Return the truth and the map of a world on a day, each on a walk of its own, without shapes."""
    size: dict[str, Any] = (
        {"width": 480, "height": 270, "rate_hz": 4.0, "seconds": 16.0} if quick else {"seconds": None}
    )
    config = RecordingConfig(scene=scene, seed=seed, walk_index=day % 2, day=day, **size)
    return mapped(config, state / f"{scene}-{seed}-{day}{'-quick' if quick else ''}.map")


def _day_figures(pairs: Sequence[PairCounts]) -> list[Figure]:
    total = sum_of(pairs)
    aligned = share("days_aligned_fraction", total.aligned, len(pairs), "pairs of days")
    unseen = Figure(
        name="gone_but_unseen", value=float(total.gone_but_unseen), unit="", better="lower", of=f"{total.gone} gone"
    )
    said = calibration_figures(total)
    return [*count_figures(total), *([aligned] if aligned is not None else []), unseen, *said]


def _person_figures(rooms: Sequence[PasserBy]) -> list[Figure]:
    objects, held, structure = (sum(getattr(one, name) for one in rooms) for name in ("objects", "held", "structure"))
    made = Figure(
        name="person_objects", value=float(sum(one.person_objects for one in rooms)), unit="", better="lower",
        of=f"{objects} objects of the maps of {len(rooms)} rooms in which a person walks",
    )  # fmt: skip
    lost = (
        share(
            "person_objects_lost",
            sum(one.lost for one in rooms),
            held,
            "true objects found without the person",
            "lower",
        ),
        share(
            "person_structure_lost",
            sum(one.structure_lost for one in rooms),
            structure,
            "voxels of structure without the person",
            "lower",
        ),
    )
    return [made, *(figure for figure in lost if figure is not None)]
