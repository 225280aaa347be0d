"""Definitions of the figures of `evaluate`, and a result as text."""

from collections.abc import Mapping, Sequence
from typing import Any

from hickory_stream.evaluation.evaluate import Evaluation, ObjectEvaluation
from hickory_stream.evaluation.false_origins import FALSE_ORIGINS
from hickory_stream.evaluation.match import Score
from hickory_stream.evaluation.miss_reasons import MISS_REASONS

_FIGURES = """\
moved        The truth is compared as it is if map and truth share a world frame. If the camera poses at equal stamps
             differ by one rigid transform (odometry with its origin at the first camera pose), the truth is moved by
             it, and this is reported. Drift is not corrected, and lowers the figures below.
box          The gravity-aligned box of an object's layer 2, or of its layer 1 if it has none; for a true object, that
             of its mesh. Tentative tracks are not counted as objects.
counts       A true object counts if the log shows at least 30 % of its surface. Others are ignored: they are not
             counted as missed, and what was mapped of them is not counted as false.
match        One-to-one pairs of true objects and objects with the largest sum of OBB IoUs, each at least the threshold.
recall       Share of the true objects that count that are matched, at IoU 0.25 and at 0.5.
reachable    A true object is reachable if in at least three keyframes the log has depth on it, at 4 or more of the
             journal's cells (64 of 640 x 480 pixels, the smallest mask). Recall is given for these alone, too.
precision    Share of the objects that are matched, at IoU 0.25 and at 0.5; objects on ignored truth are left out.
fixtures     A fixture matches a true object as an object does; the share of the matched that it has is given. Without a
             match it is false, except on structure: most of its points are nearest to true structure, and within 3 cm
             or the depth noise at its farthest view. Then it is left out of precision. Labels have no structure.
generated    Share of the surface of all layers 2 that no view shows: of each face, the share of its vertices.
invented     Volume of layer 2 of the matched that is farther than 5 cm outside the true object, over the true volume.
             A true object holds what air from outside does not reach; floor and walls close meshes that lack a side.
tracks       Mean number of objects on a true object that has any. An object lies on a true object if more than half of
             its points are within 3 cm of it, and nearer to it than to any other true object.
labels       Boxes labelled by hand give recall, precision, tracks and generated surface alone. Depth is on a label at
             the cells whose points lie in its box. The IoU is the larger one of those with the box of the whole object
             and with that of its seen part. An object lies on the smallest label that holds more than half of its
             points, and is ignored with it.
F1           Harmonic mean of recall (true surface samples within a distance of the placed mesh of layer 2) and
             precision (samples of that mesh within it of the true mesh), at 1 cm and at 5 % of the true diameter; the
             true samples are on the surface of the union of the object's parts that is visible from outside. A true
             object without a match at IoU 0.25, or whose match has no layer 2, scores 0. `matched` is the mean over
             those that have a match.
diameter d   The largest distance between two points of the true mesh.
ADD-S        Mean distance from the true surface samples to the placed mesh; a success below 0.1 d (0.05 d). No match or
             no layer 2 is a failure.
containment  Share of the visible true surface samples (their pixel shows the object, from 0.3 to 8 m, with nothing in
             between) that lie in the union of the inflated superquadrics of the match.
ATE          RMSE of the camera positions of the kept views against the true ones: as placed, and after the best rigid
             alignment.
mask purity  Share of a kept view's mask that shows its most frequent true instance (the background is one), averaged
             over the kept views."""


def _listed(meanings: Mapping[Any, str]) -> str:
    return "\n".join(f"             {name}: {meaning}." for name, meaning in meanings.items())


DEFINITIONS = f"""\
{_FIGURES}
missed       Why a true object that counts has no match, on the page and by `explain`: one of
{_listed(MISS_REASONS)}
false        Where an object comes from that has no match, and is not of ignored truth: one of
{_listed(FALSE_ORIGINS)}"""


def format_evaluation(evaluation: Evaluation) -> str:
    """Return an evaluation as a table of true objects, worst first, and its figures."""
    lines = [
        f"{'true object':<22}{'d':>7}{'seen':>7}{'match':>8}{'IoU':>7}{'F1 5%':>7}{'ADD-S/d':>9}{'inside':>9}  tracks"
    ]
    for row in worst_first(evaluation):
        match = f"#{row.map_id}" if row.map_id is not None else "-"
        add_s = f"{row.add_s_m / row.diameter_m:.3f}" if row.add_s_m is not None else "-"
        inside = f"{row.contained:.4f}" if row.contained is not None else "-"
        tracks = _ids(row.track_ids) or "-"
        name = f"{row.truth_id} {row.kind}"
        lines.append(
            f"{name:<22}{row.diameter_m:>7.2f}{row.seen_fraction:>7.2f}{match:>8}{row.iou:>7.2f}{row.f1_5pct:>7.2f}"
            f"{add_s:>9}{inside:>9}  {tracks}"
        )
    strays = _ids(evaluation.stray_ids) or "none"
    lines += [
        "",
        f"objects on no true object: {strays}",
        "",
        *(f"{name:<24}{text}" for name, text in figures(evaluation)),
    ]
    return "\n".join(lines)


def format_labels(score: Score) -> str:
    """Return a score against labelled boxes as a table of those that count, worst first, and its figures."""
    lines = [f"{'label':<24}{'match':>8}{'IoU':>7}  objects on it"]
    for row in sorted((row for row in score.truth if row.counts), key=lambda row: (row.iou, row.truth_id)):
        match = f"#{row.map_id}" if row.map_id is not None else "-"
        lines.append(f"{f'{row.truth_id} {row.kind}':<24}{match:>8}{row.iou:>7.2f}  {_ids(row.track_ids) or '-'}")
    lines += ["", f"objects on no label: {_ids(score.stray_ids) or 'none'}"]
    lines += [f"objects on ignored labels: {_ids(score.ignored_ids) or 'none'}", ""]
    return "\n".join([*lines, *(f"{name:<24}{text}" for name, text in _counts(score))])


def _ids(ids: Sequence[int]) -> str:
    return " ".join(f"#{i}" for i in ids)


def _counts(e: Evaluation | Score) -> list[tuple[str, str]]:
    reach = f" ({e.num_reachable} true objects)" if e.num_reachable is not None else " (no journal)"
    return [
        ("true objects / objects", f"{e.num_truth} / {e.num_objects}"),
        ("recall 0.25 / 0.5", f"{e.recall_25:.3f} / {e.recall_50:.3f}"),
        ("recall of the reachable", f"{_number(e.reachable_recall_25)} / {_number(e.reachable_recall_50)}{reach}"),
        ("precision 0.25 / 0.5", f"{e.precision_25:.3f} / {e.precision_50:.3f}"),
        ("tracks per true object", f"{e.tracks_per_object:.3f}"),
        ("found as fixtures", f"{_number(e.fixture_share)}; {len(e.structure_ids)} more on structure"),
        ("generated surface", _number(e.generated_share)),
    ]


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f}"


def figures(evaluation: Evaluation) -> list[tuple[str, str]]:
    """Return the figures of an evaluation with their names, as text."""
    e = evaluation
    rows = [
        *_counts(e),
        ("F1 5 % / 1 cm", f"{e.f1_5pct:.3f} / {e.f1_1cm:.3f}"),
        ("F1 5 % of the matched", f"{e.matched_f1_5pct:.3f}"),
        ("ADD-S < 0.1 d / 0.05 d", f"{e.adds_10:.3f} / {e.adds_05:.3f}"),
        ("containment", f"{e.containment:.5f}" if e.containment is not None else "no layer 4"),
        ("invented volume", _number(e.invented_volume)),
    ]
    if e.placement is not None:
        p = e.placement
        text = f"by {p.distance_m:.2f} m and {p.turned_deg:.1f} deg, from {p.num_poses} poses"
        rows.append(("truth was moved", f"{text} (median rest {p.rest_m:.3f} m, {p.rest_deg:.2f} deg)"))
    if e.poses is not None:
        rows.append(("ATE placed / aligned", f"{e.poses.ate_m:.4f} m / {e.poses.ate_aligned_m:.4f} m"))
    if e.mask_purity is not None:
        rows.append(("mask purity", f"{e.mask_purity:.3f}"))
    return rows


def worst_first(evaluation: Evaluation) -> list[ObjectEvaluation]:
    """Return the true objects with the worst surface first; among the missed, the best seen first."""
    return sorted(evaluation.objects, key=lambda row: (row.f1_5pct, -row.seen_fraction, row.truth_id))


def verdict(row: ObjectEvaluation) -> str:
    """Return the outcome of a true object in a phrase."""
    parts = []
    if row.map_id is None:
        parts.append("missed" if not row.track_ids else "found, but its box is off")
    elif row.add_s_m is None:
        parts.append("found, without a shape")
    elif row.f1_5pct < 0.7:
        parts.append("poor shape")
    elif row.f1_5pct < 0.9:
        parts.append("fair shape")
    else:
        parts.append("good")
    if row.map_id is not None and row.map_id not in row.track_ids:
        parts.append("its match lies mostly on something else")
    if row.is_fixture:
        parts.append("as a fixture")
    if len(row.track_ids) > 1:
        parts.append(f"in {len(row.track_ids)} pieces")
    if row.contained is not None and row.contained < 0.999:
        parts.append(f"{1 - row.contained:.2%} sticks out of layer 4")
    return "; ".join(parts)
