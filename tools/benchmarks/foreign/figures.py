"""Figures of the gate, each with its denominator, exclusions, an interval and its role."""
# Shares have Wilson's interval, true objects taken for independent; means, differences and F1 have a bootstrap over
# true objects (over clouds for masks). Both are 95 %. A thing is large from 0.4 m between its farthest points on.

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from tools.benchmarks.common.figures import Better, Figure, figure, mean, share
from tools.benchmarks.common.intervals import bootstrap
from tools.benchmarks.foreign.parts import CAMERAS, CAMPUS, CAMPUS_WALKS, OUTDOORS, OWN, ROLES, WALKS, WORLDS, Part
from tools.evaluation.oracle_ablation import Rung

Record = Mapping[str, Any]
Measured = Mapping[Part, Record]

LARGE_M = 0.4
_NEAR_M = 5.0
_OBJECTS = "bootstrap over true objects"
_MIXED = "home and bookstore tuned on, office and warehouse reported"
_TO_STRUCTURE = ("taken for structure", "dropped as structure")
_LITTLE_SEEN = "{} true objects of which under 30 % was seen"


def figures_of(measured: Measured) -> list[Figure]:
    figures = []
    for part, record in measured.items():
        if part.walk and part.rung == "ours":
            headline = CAMPUS_WALKS[0] if part.world == CAMPUS else ("A", "hand")
            is_headline = (part.walk, part.camera) == headline
            name = part.world if is_headline else f"{part.world}_{part.walk}_{part.camera}"
            figures += of_map(name, record, ROLES[part.world])
            figures += _of_campus(name, record) if part.world == CAMPUS else []
    figures += _of_ladder(measured)
    figures += _of_robot(measured)
    by_hand = [record for world in WORLDS if (record := _a_by_hand(measured, world)) is not None]
    if len(by_hand) == len(WORLDS):
        figures += _of_structure(_joined(by_hand)) + _of_shapes("foreign", _joined(by_hand), _MIXED)
    own, streets = ([measured[Part(world=n)] for n in names if Part(world=n) in measured] for names in (OWN, OUTDOORS))
    if own:
        figures += of_map("own", _joined(own), ROLES["own1"])
        figures += [one for one in _of_shapes("own", _joined(own), ROLES["own1"]) if one.name == "own_f1_5pct"]
    figures += _of_outdoors(streets)
    for name, of_record in (
        ("kitchen", _of_kitchen),
        ("clouds_tuned", _of_clouds),
        ("clouds_report", _of_clouds),
        ("speed", _of_speed),
    ):
        if Part(world=name) in measured:
            figures += of_record(name, measured[Part(world=name)])
    return figures


def of_map(name: str, record: Record, role: str) -> list[Figure]:
    """Return recall and precision of a map, for all things and for large and small ones apart."""
    truth, objects = record["truth"], record["objects"]
    counted, fixtures = _counted(objects), sum(o["is_structure"] for o in objects)
    unseen = _LITTLE_SEEN.format(record["little_seen"])
    ignored = f"{len(objects) - len(counted) - fixtures} objects of true ones of which under 30 % was seen"
    ignored += f", {fixtures} fixtures on structure" if fixtures else ""
    groups: dict[str, Callable[[Record], bool]] = {
        "": lambda _: True,
        "large_": lambda row: row["size_m"] > LARGE_M,
        "small_": lambda row: row["size_m"] <= LARGE_M,
    }
    figures: list[Figure] = []
    for group, belongs in groups.items():
        figures += _share(f"{name}_{group}recall_25", filter(belongs, truth), "found_25", "true objects", unseen, role)
        mine = filter(belongs, counted)
        figures += _share(f"{name}_{group}precision_25", mine, "right_25", "objects", ignored, role)
    figures += _share(f"{name}_recall_50", truth, "found_50", "true objects", unseen, role)
    within = [row for row in truth if row["is_reachable"]]
    far = f"{unseen}, {len(truth) - len(within)} with depth in fewer than three keyframes"
    for level in ("25", "50"):
        figures += _share(f"{name}_reachable_recall_{level}", within, f"found_{level}", "true objects", far, role)
    found = [row for row in truth if row["found_25"]]
    figures += _share(f"{name}_fixture_share", found, "is_fixture", "true objects found", "", role, "same")
    figures += _ratio(f"{name}_generated_share", objects, "generated_m2", "surface_m2", "surface of {} objects", role)
    return figures + _invented(name, truth, role)


def reasons(record: Record) -> list[str]:
    """Return in words how many true objects a map misses, and how many of its objects are false, by reason."""
    lines = []
    for what, rows, key in (
        ("missed", record["truth"], "missed_because"),
        ("false", record["objects"], "false_because"),
    ):
        counts = Counter(row[key] for row in rows if row[key] is not None)
        each = ", ".join(f"{count} {reason}" for reason, count in counts.most_common())
        lines.append(f"{sum(counts.values())} {what}: {each or '-'}")
    return lines


def _counted(objects: Iterable[Record]) -> list[Record]:
    return [row for row in objects if row["right_25"] or not (row["ignored"] or row["is_structure"])]


def _ratio(name: str, rows: Iterable[Record], part: str, whole: str, of: str, role: str) -> list[Figure]:
    pairs = [(row[part], row[whole]) for row in rows if row[whole]]
    more = {"statistic": _quotient, "role": role, "interval_by": "bootstrap over objects"}
    return [mean(name, pairs, "", "lower", of.format(len(pairs)), **more)] if pairs else []


def _invented(name: str, truth: Iterable[Record], role: str) -> list[Figure]:
    return _ratio(f"{name}_invented_volume", truth, "invented_m3", "true_m3", "volume of {} true objects found", role)


def _share(
    name: str, rows: Iterable[Record], key: str, of: str, left_out: str, role: str, better: Better = "higher"
) -> list[Figure]:
    chosen = [bool(row[key]) for row in rows]
    return share(name, sum(chosen), len(chosen), of, better, left_out=left_out, role=role)


def _a_by_hand(measured: Measured, world: str, rung: Rung = "ours") -> Record | None:
    return measured.get(Part(world=world, walk="A", camera="hand", rung=rung))


def _joined(records: Sequence[Record]) -> Record:
    joined: dict[str, Any] = {"truth": [], "objects": [], "little_seen": 0}
    for record in records:
        for key in joined:
            joined[key] = joined[key] + record[key]
    return joined


def _of_ladder(measured: Measured) -> list[Figure]:
    figures: list[Figure] = []
    for world in WORLDS:
        for rung in ("joins", "masks", "structure", "association"):
            if (record := _a_by_hand(measured, world, rung)) is not None:
                name = f"{world}_true_{rung}"
                wanted = (f"{name}_recall_25", f"{name}_precision_25")
                figures += [one for one in of_map(name, record, ROLES[world]) if one.name in wanted]
    return figures + _gap("ladder_gap_masks", measured, "masks") + _gap("ladder_gap_joins", measured, "joins")


def _gap(name: str, measured: Measured, rung: Literal["masks", "joins"]) -> list[Figure]:
    gains = []
    for world in WORLDS:
        true, ours = _a_by_hand(measured, world, rung), _a_by_hand(measured, world)
        if true is None or ours is None:
            return []
        found = {row["id"]: row["found_25"] for row in ours["truth"]}
        gains.append(np.array([float(row["found_25"]) - float(found[row["id"]]) for row in true["truth"]]))
    of = f"mean of {len(gains)} worlds, {sum(map(len, gains))} true objects"
    return [_statistic(name, gains, _mean_of_means, of, "true objects of which under 30 % was seen")]


def _of_robot(measured: Measured) -> list[Figure]:
    found: list[NDArray[np.float64]] = []
    for world in WORLDS:
        for walk in WALKS:
            pair = [measured.get(Part(world=world, walk=walk, camera=camera)) for camera in CAMERAS]
            if None not in pair:
                found += [np.array([float(row["found_25"]) for row in r["truth"]]) for r in pair if r is not None]
    if len(found) < 2 * len(WORLDS):
        return []

    def loss(rows: Sequence[NDArray[np.float64]]) -> float:
        return _mean_of_means(rows[::2]) - _mean_of_means(rows[1::2])

    unseen = "true objects of which under 30 % was seen, in each walk by itself"
    return [_statistic("robot_recall_25_loss", found, loss, f"mean of {len(found) // 2} walks", unseen)]


def _statistic(
    name: str, groups: Sequence[NDArray[np.float64]], statistic: Callable[[Sequence[NDArray[np.float64]]], float],
    of: str, left_out: str,
) -> Figure:  # fmt: skip
    interval = {"interval": bootstrap(groups, statistic), "interval_by": _OBJECTS}
    return figure(name, statistic(groups), "", "lower", of, left_out=left_out, role=_MIXED, **interval)


def _of_structure(every: Record) -> list[Figure]:
    truth = [{"lost": row["missed_because"] in _TO_STRUCTURE} for row in every["truth"]]
    objects = [{"false": row["false_because"] == "structure"} for row in _counted(every["objects"])]
    unseen = _LITTLE_SEEN.format(every["little_seen"])
    return [
        *_share("foreign_structure_swallowed", truth, "lost", "true objects", unseen, _MIXED, "lower"),
        *_share("foreign_structure_phantoms", objects, "false", "objects", "objects of these", _MIXED, "lower"),
    ]


def _of_shapes(name: str, every: Record, role: str) -> list[Figure]:
    truth = every["truth"]
    if not truth:
        return []
    adds = [float(row["adds_10"]) for row in truth]
    tracks = [float(row["tracks"]) for row in truth if row["tracks"]]
    inside = [(row["contained"] * row["num_seen"], row["num_seen"]) for row in truth if row["contained"] is not None]
    rows: tuple[tuple[str, Any, Any, str, Better], ...] = (
        ("f1_5pct", [row["f1_5pct"] for row in truth], np.mean, f"{len(truth)} true objects, a missed one 0", "higher"),
        ("adds_10", adds, np.mean, f"{int(sum(adds))} of {len(adds)} true objects", "higher"),
        ("containment", inside, _quotient, f"seen samples of {len(inside)} true objects with layer 4", "higher"),
        ("tracks_per_object", tracks, np.mean, f"{len(tracks)} true objects with a track", "lower"),
    )
    more = {"left_out": "true objects of which under 30 % was seen", "interval_by": _OBJECTS, "role": role}
    found = [row for row in truth if row["found_25"]]
    return [
        *(
            mean(f"{name}_{kind}", values, "", better, of, statistic=statistic, **more)
            for kind, values, statistic, of, better in rows
            if values
        ),
        *_share("things_found_50_over_25", found, "found_50", "true objects found", "the missed", role),
        *_invented(name, truth, role),
    ]


def _of_campus(name: str, record: Record) -> list[Figure]:
    near = [row for row in record["truth"] if row["nearest_m"] <= _NEAR_M]
    far = f"those more than {_NEAR_M:g} m from the walk"
    return [
        *_share(f"{name}_near_recall_25", near, "found_25", "true objects", far, ROLES[CAMPUS]),
        _pieces(f"{name}_ground_pieces", record, "objects and fixtures", ROLES[CAMPUS]),
    ]


def _of_outdoors(records: Sequence[Record]) -> list[Figure]:
    if not records:
        return []
    joined, role = _joined(records), ROLES[OUTDOORS[0]]
    pieces = _pieces("outdoor_ground_objects", joined, f"objects of {len(records)} streets", role)
    return [*of_map("outdoor", joined, role), pieces]


def _pieces(name: str, record: Record, of: str, role: str) -> Figure:
    # Outdoors, true structure is ground, fronts of houses and, in streets of ours, crowns of trees.
    count = sum(row["false_because"] == "structure" for row in record["objects"])
    of = f"{len(record['objects'])} {of}"
    return figure(name, count, "", "lower", of, left_out="tentative objects, fixtures on it", role=role)


def _of_kitchen(name: str, record: Record) -> list[Figure]:
    truth, right, false = record["truth"], record["found"]["0.25"], record["false"]["0.25"]
    ignored = f"{record['ignored_truth']} labelled regions that are marked to be ignored"
    more: dict[str, Any] = {"left_out": ignored, "role": ROLES[name]}
    figures = share("kitchen_recall_25", right, len(truth), "labelled objects", **more)
    figures += share("kitchen_recall_50", record["found"]["0.5"], len(truth), "labelled objects", **more)
    within = [row["found_25"] for row in truth if row["reachable"]]
    figures += share("kitchen_reachable_recall_25", sum(within), len(within), "labelled objects", **more)
    if (generated := record["generated_share"]) is not None:
        figures.append(
            figure("kitchen_generated_share", generated, "", "lower", "surface of objects", role=ROLES[name])
        )
    left_out = f"{record['not_counted']['0.25']} objects in ignored regions"
    figures += share("kitchen_precision_25", right, right + false, "objects", **more | {"left_out": left_out})
    for group, is_large in (("large", True), ("small", False)):
        rows = [row["found_25"] for row in truth if (row["size_m"] > LARGE_M) is is_large]
        figures += share(f"kitchen_{group}_recall_25", sum(rows), len(rows), "labelled objects", **more)
    return figures


def _of_clouds(name: str, record: Record) -> list[Figure]:
    counts = np.array([[c["right"], c["things"], c["masks"]] for c in record["clouds"]], dtype=np.float64)
    right, things, masks = (int(n) for n in counts.sum(axis=0))
    of = f"{len(counts)} clouds, {right} right of {things} things and {masks} masks"
    small = f"{sum(cloud['small'] for cloud in record['clouds'])} things under 0.2 % of their image"
    more = {"left_out": small, "interval_by": "bootstrap over clouds", "role": ROLES[name]}
    return [mean(f"{name}_f1_50", counts, "", "higher", of, statistic=_f1, **more)]


def _of_speed(_name: str, record: Record) -> list[Figure]:
    of = f"median of {record['keyframes']} keyframes of home, 640x480, processor time"
    return [
        figure("segmenter", str(record["segmenter"]), "", "same"),
        figure("segmenter_ms", record["segmenter_ms"], "ms", "lower", of),
        figure("keyframe_ms", record["keyframe_ms"], "ms", "lower", of),
        figure("weights_mb", record["weights_mb"], "MB", "lower"),
    ]


def _quotient(values: NDArray[np.float64]) -> float:
    return float(values[:, 0].sum() / max(values[:, 1].sum(), 1e-12))


def _mean_of_means(groups: Sequence[NDArray[np.float64]]) -> float:
    return float(np.mean([group.mean() for group in groups]))


def _f1(counts: NDArray[np.float64]) -> float:
    right, things, masks = counts.sum(axis=0)
    return float(2 * right / max(things + masks, 1.0))
