"""From what was measured to figures: each with its denominator, what is left out and why, an interval and its role.

Shares have Wilson's interval, true objects taken for independent; means, differences and F1 that of a bootstrap over
true objects (over clouds for masks). Both are 95 %. A thing is large from 0.4 m between its farthest points on.
"""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from tools.benchmarks.figures import Figure
from tools.benchmarks.foreign_parts import CAMERAS, OUTDOORS, OWN, ROLES, WALKS, WORLDS, Part
from tools.benchmarks.intervals import bootstrap, wilson

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence

    from numpy.typing import NDArray

    from tools.evaluation.oracle_ablation import Rung

    Measured = Mapping[Part, dict[str, Any]]

LARGE_M = 0.4
_OBJECTS = "bootstrap over true objects"
_MIXED = "home and bookstore tuned on, office and warehouse reported"
_TO_STRUCTURE = ("taken for structure", "dropped as structure")
_LITTLE_SEEN = "{} true objects of which under 30 % was seen"


def figures_of(measured: Measured) -> list[Figure]:
    """Return every figure that the measured parts give; one that cannot be told is absent."""
    figures = []
    for world in WORLDS:
        for walk in WALKS:
            for camera in CAMERAS:
                record = measured.get(Part(world=world, walk=walk, camera=camera))
                if record is not None:
                    is_headline = (walk, camera) == ("A", "hand")
                    name = world if is_headline else f"{world}_{walk}_{camera}"
                    figures += of_map(name, record, ROLES[world])
    figures += _of_ladder(measured)
    figures += _of_robot(measured)
    figures += _of_structure([_a_by_hand(measured, world) for world in WORLDS])
    figures += _of_shapes("foreign", [_a_by_hand(measured, world) for world in WORLDS], _MIXED)
    own = [record for name in OWN if (record := measured.get(Part(world=name))) is not None]
    if own:
        joined = _joined(own)
        figures += of_map("own", joined, ROLES["own1"])
        figures += [figure for figure in _of_shapes("own", own, ROLES["own1"]) if figure.name == "own_f1_5pct"]
    figures += _of_outdoors([record for name in OUTDOORS if (record := measured.get(Part(world=name))) is not None])
    figures += _of_kitchen(measured.get(Part(world="kitchen")))
    for name in ("clouds_tuned", "clouds_report"):
        figures += _of_clouds(name, measured.get(Part(world=name)))
    return figures + _of_speed(measured.get(Part(world="speed")))


def of_map(name: str, record: Mapping[str, Any], role: str) -> list[Figure]:
    """Return recall and precision of a map, for all things and for large and small ones apart."""
    truth, objects = record["truth"], record["objects"]
    unseen = _LITTLE_SEEN.format(record["little_seen"])
    counted = {key: [o for o in objects if o[key] or not o["ignored"]] for key in ("right_25", "right_50")}
    ignored = f"{len(objects) - len(counted['right_25'])} objects of true ones of which under 30 % was seen"
    groups: list[tuple[str, Callable[[Mapping[str, Any]], bool]]] = [
        ("", lambda _: True),
        ("large_", lambda row: row["size_m"] > LARGE_M),
        ("small_", lambda row: row["size_m"] <= LARGE_M),
    ]
    figures = []
    for group, belongs in groups:
        figures.append(_share(f"{name}_{group}recall_25", truth, "found_25", belongs, "true objects", unseen, role))
        figures.append(
            _share(f"{name}_{group}precision_25", counted["right_25"], "right_25", belongs, "objects", ignored, role)
        )
    figures.append(_share(f"{name}_recall_50", truth, "found_50", groups[0][1], "true objects", unseen, role))
    return [figure for figure in figures if figure is not None]


def _share(
    name: str,
    rows: Sequence[Mapping[str, Any]],
    key: str,
    belongs: Callable[[Mapping[str, Any]], bool],
    what: str,
    left_out: str,
    role: str,
) -> Figure | None:
    chosen = [bool(row[key]) for row in rows if belongs(row)]
    return _proportion(name, sum(chosen), len(chosen), what, left_out, role)


def _proportion(
    name: str,
    found: int,
    total: int,
    what: str,
    left_out: str,
    role: str,
    better: Literal["higher", "lower"] = "higher",
) -> Figure | None:
    if not total:
        return None
    return Figure(
        name=name,
        value=found / total,
        unit="",
        better=better,
        of=f"{found} of {total} {what}",
        left_out=left_out,
        interval=wilson(found, total),
        interval_by="Wilson",
        role=role,
    )


def _a_by_hand(measured: Measured, world: str, rung: Rung = "ours") -> dict[str, Any] | None:
    return measured.get(Part(world=world, walk="A", camera="hand", rung=rung))


def _joined(records: Iterable[Mapping[str, Any]]) -> dict[str, Any]:
    joined: dict[str, Any] = {"truth": [], "objects": [], "little_seen": 0}
    for record in records:
        for key in joined:
            joined[key] = joined[key] + record[key]
    return joined


def _of_ladder(measured: Measured) -> list[Figure]:
    """Return recall and precision of each rung of each world, and what is lost to masks and to joins."""
    figures: list[Figure] = []
    for world in WORLDS:
        for rung in ("joins", "masks", "structure", "association"):
            record = _a_by_hand(measured, world, rung)
            if record is not None:
                kept = (f"{world}_true_{rung}_recall_25", f"{world}_true_{rung}_precision_25")
                figures += [f for f in of_map(f"{world}_true_{rung}", record, ROLES[world]) if f.name in kept]
    for name, rung in (("ladder_gap_masks", "masks"), ("ladder_gap_joins", "joins")):
        figures += _gap(name, measured, rung)
    return figures


def _gap(name: str, measured: Measured, rung: Literal["masks", "joins"]) -> list[Figure]:
    """Return how much recall a rung has over ours, the mean of the worlds; absent where a world was not measured."""
    pairs = [(_a_by_hand(measured, world, rung), _a_by_hand(measured, world)) for world in WORLDS]
    gains = []
    for true, ours in pairs:
        if true is None or ours is None:
            return []
        found = {row["id"]: row["found_25"] for row in ours["truth"]}
        gains.append(np.array([float(row["found_25"]) - float(found[row["id"]]) for row in true["truth"]]))
    return [
        Figure(
            name=name,
            value=_mean_of_means(gains),
            unit="",
            better="lower",
            of=f"mean of {len(gains)} worlds, {sum(map(len, gains))} true objects",
            left_out="true objects of which under 30 % was seen",
            interval=bootstrap(gains, _mean_of_means),
            interval_by=_OBJECTS,
            role=_MIXED,
        )
    ]


def _of_robot(measured: Measured) -> list[Figure]:
    """Return how much recall a walk of a robot loses to the same walk by hand, the mean of the walks."""
    found: list[NDArray[np.float64]] = []
    for world in WORLDS:
        for walk in WALKS:
            pair = [measured.get(Part(world=world, walk=walk, camera=camera)) for camera in CAMERAS]
            if pair[0] is not None and pair[1] is not None:
                found += [np.array([float(row["found_25"]) for row in r["truth"]]) for r in pair if r is not None]
    if len(found) < 2 * len(WORLDS):
        return []

    def loss(rows: Sequence[NDArray[np.float64]]) -> float:
        return _mean_of_means(rows[::2]) - _mean_of_means(rows[1::2])

    return [
        Figure(
            name="robot_recall_25_loss",
            value=loss(found),
            unit="",
            better="lower",
            of=f"mean of {len(found) // 2} walks",
            left_out="true objects of which under 30 % was seen, in each walk by itself",
            interval=bootstrap(found, loss),
            interval_by=_OBJECTS,
            role=_MIXED,
        )
    ]


def reasons(record: Mapping[str, Any]) -> list[str]:
    """Return in words how many true objects of a map are missed, and how many of its objects are false, and why."""
    lines = []
    for what, rows, key in (
        ("missed", record["truth"], "missed_because"),
        ("false", record["objects"], "false_because"),
    ):
        counts = Counter(row[key] for row in rows if row[key] is not None)
        told = ", ".join(f"{count} {reason}" for reason, count in counts.most_common())
        lines.append(f"{sum(counts.values())} {what}: {told or '-'}")
    return lines


def _of_structure(records: Sequence[dict[str, Any] | None]) -> list[Figure]:
    """Return how many true objects are lost to structure, and how many objects are pieces of it, over all worlds."""
    known = [record for record in records if record is not None]
    if len(known) < len(records):
        return []
    truth = [row["missed_because"] in _TO_STRUCTURE for record in known for row in record["truth"]]
    objects = [
        o["false_because"] == "structure" for r in known for o in r["objects"] if o["right_25"] or not o["ignored"]
    ]
    unseen, ignored = (_LITTLE_SEEN.format(sum(r["little_seen"] for r in known)), "objects of these")
    figures = [
        _proportion("foreign_structure_swallowed", sum(truth), len(truth), "true objects", unseen, _MIXED, "lower"),
        _proportion("foreign_structure_phantoms", sum(objects), len(objects), "objects", ignored, _MIXED, "lower"),
    ]
    return [figure for figure in figures if figure is not None]


def _of_shapes(name: str, records: Sequence[dict[str, Any] | None], role: str) -> list[Figure]:
    """Return the figures of surfaces and tracks over all true objects of some maps, none where a map is missing."""
    if any(record is None for record in records):
        return []
    truth = [row for record in records if record is not None for row in record["truth"]]
    if not truth:
        return []
    f1 = np.array([row["f1_5pct"] for row in truth])
    adds = np.array([float(row["adds_10"]) for row in truth])
    tracks = np.array([float(row["tracks"]) for row in truth if row["tracks"]])
    inside = np.array(
        [[row["contained"] * row["num_seen"], row["num_seen"]] for row in truth if row["contained"] is not None]
    )
    rows: list[tuple[str, NDArray[np.float64], Callable[[NDArray[np.float64]], float], str, Literal["higher", "lower"]]]
    rows = [
        ("f1_5pct", f1, _mean, f"{len(f1)} true objects, a missed one 0", "higher"),
        ("adds_10", adds, _mean, f"{int(adds.sum())} of {len(adds)} true objects", "higher"),
        ("containment", inside, _ratio, f"seen samples of {len(inside)} true objects with layer 4", "higher"),
        ("tracks_per_object", tracks, _mean, f"{len(tracks)} true objects with a track", "lower"),
    ]
    figures = []
    for kind, values, statistic, of, better in rows:
        if len(values):
            figures.append(
                Figure(
                    name=f"{name}_{kind}",
                    value=statistic(values),
                    unit="",
                    better=better,
                    of=of,
                    left_out="true objects of which under 30 % was seen",
                    interval=bootstrap([values], lambda groups, statistic=statistic: statistic(groups[0])),  # type: ignore[misc]
                    interval_by=_OBJECTS,
                    role=role,
                )
            )
    return figures


def _of_outdoors(records: Sequence[Mapping[str, Any]]) -> list[Figure]:
    """Return recall and precision of the streets together, and how many of their objects are pieces of ground."""
    if not records:
        return []
    joined, role = _joined(records), ROLES[OUTDOORS[0]]
    pieces = sum(row["is_ground"] for row in joined["objects"])
    count = Figure(
        name="outdoor_ground_objects",
        value=pieces,
        unit="",
        better="lower",
        of=f"{len(joined['objects'])} objects of {len(records)} streets",
        left_out="tentative objects",
        role=role,
    )
    return [*of_map("outdoor", joined, role), count]


def _of_kitchen(record: Mapping[str, Any] | None) -> list[Figure]:
    if record is None:
        return []
    role, truth = ROLES["kitchen"], record["truth"]
    ignored = f"{record['ignored_truth']} labelled regions that are marked to be ignored"
    figures: list[Figure | None] = []
    for name, level in (("recall_25", "0.25"), ("recall_50", "0.5")):
        figures.append(
            _proportion(f"kitchen_{name}", record["found"][level], len(truth), "labelled objects", ignored, role)
        )
    right, false = record["found"]["0.25"], record["false"]["0.25"]
    left_out = f"{record['not_counted']['0.25']} objects in ignored regions"
    figures.append(_proportion("kitchen_precision_25", right, right + false, "objects", left_out, role))
    for group, is_large in (("large", True), ("small", False)):
        rows = [row["found_25"] for row in truth if (row["size_m"] > LARGE_M) is is_large]
        figures.append(
            _proportion(f"kitchen_{group}_recall_25", sum(rows), len(rows), "labelled objects", ignored, role)
        )
    return [figure for figure in figures if figure is not None]


def _of_clouds(name: str, record: Mapping[str, Any] | None) -> list[Figure]:
    if record is None:
        return []
    counts = np.array([[c["right"], c["things"], c["masks"]] for c in record["clouds"]], dtype=np.float64)
    right, things, masks = (int(n) for n in counts.sum(axis=0))
    small = sum(cloud["small"] for cloud in record["clouds"])
    return [
        Figure(
            name=f"{name}_f1_50",
            value=_f1([counts]),
            unit="",
            better="higher",
            of=f"{len(counts)} clouds, {right} right of {things} things and {masks} masks",
            left_out=f"{small} things under 0.2 % of their image",
            interval=bootstrap([counts], _f1),
            interval_by="bootstrap over clouds",
            role=ROLES[name],
        )
    ]


def _of_speed(record: Mapping[str, Any] | None) -> list[Figure]:
    if record is None:
        return []
    of = f"median of {record['keyframes']} keyframes of home, 640x480, processor time"
    return [
        Figure(name="segmenter", value=str(record["segmenter"]), unit="", better="same"),
        Figure(name="segmenter_ms", value=record["segmenter_ms"], unit="ms", better="lower", of=of),
        Figure(name="keyframe_ms", value=record["keyframe_ms"], unit="ms", better="lower", of=of),
        Figure(name="weights_mb", value=record["weights_mb"], unit="MB", better="lower"),
    ]


def _mean(values: NDArray[np.float64]) -> float:
    return float(values.mean())


def _ratio(values: NDArray[np.float64]) -> float:
    return float(values[:, 0].sum() / max(values[:, 1].sum(), 1.0))


def _mean_of_means(groups: Sequence[NDArray[np.float64]]) -> float:
    return float(np.mean([group.mean() for group in groups]))


def _f1(groups: Sequence[NDArray[np.float64]]) -> float:
    right, things, masks = groups[0].sum(axis=0)
    return float(2 * right / max(things + masks, 1.0))
