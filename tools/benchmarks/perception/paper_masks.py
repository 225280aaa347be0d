"""Maps with the paper's networks, simulated from truth: what each of their errors costs, and why things are lost."""
# Layer 1 alone, for speed: no shapes are made, and boxes are compared as tracks have them. Exact odometry, walk A by
# hand. The top of the ladder has no name in figures: `home_masks_recall_25` has habits and classes.

import tempfile
from pathlib import Path
from typing import Any

from hickory_stream.base.config_text import read_config
from hickory_stream.config import MapperConfig
from hickory_stream.errors import InputError
from hickory_stream.evaluation.truth import load_truth
from tools.benchmarks.common.cached_runs import cached
from tools.benchmarks.common.code_hashes import MAPS, code_hash
from tools.benchmarks.common.figures import Figure, Options, figure
from tools.benchmarks.common.processes import NO_SHAPES
from tools.benchmarks.foreign.figures import of_map, reasons
from tools.benchmarks.foreign.logs import WorldLog, foreign_log, worlds_folder
from tools.benchmarks.foreign.parts import REPORTED, REPORTED_WORLDS, TUNED, TUNED_WORLDS
from tools.benchmarks.foreign.runs import mapped
from tools.evaluation.masks.simulated_networks import LADDER, OTHER_RATES, WITHOUT_HABITS, segmenter_with_errors

_QUICK_S, _TOP = 12.0, LADDER[-1]
_NAMES = {_TOP: "masks", "outlines": "true_masks"}
_FIGURES = ("recall_25", "precision_25", "recall_50")
_SCORES = ("hickory_stream/evaluation", "tools/benchmarks/foreign/runs.py", "tools/evaluation/masks")


def measure(options: Options) -> list[Figure]:
    """Return the figures of each world and rung; `--only` names worlds and rungs, `WORLD:RUNG` both."""
    worlds, state = worlds_folder(options.worlds), options.state / f"paper-masks-{code_hash(*MAPS, *_SCORES)[:12]}"
    figures, tracks = list[Figure](), list[int]()
    for world, rungs in _chosen(options).items():
        log = foreign_log(worlds, world, "A", "hand", _QUICK_S if options.quick else 60.0)
        role, before = TUNED if world in TUNED_WORLDS else REPORTED, None
        for rung in rungs:
            seed = options.seed + (rung == OTHER_RATES)
            file = state / f"{world}-{log.key}-{rung}-{seed}.json"
            record = cached(file, lambda log=log, rung=rung, seed=seed: _mapped(log, worlds.parent, rung, seed))
            name = f"{'quick_' if options.quick else ''}{world}_{_NAMES.get(rung, f'{rung}_masks')}"
            own = [one for one in of_map(name, record, role) if one.name.removeprefix(f"{name}_") in _FIGURES]
            found = sum(row["found_25"] for row in record["truth"])
            cost = "" if before is None else f", {before - found:+d} lost by it"
            print(f"{name}: {found} of {len(record['truth'])} found{cost}; {'; '.join(reasons(record))}", flush=True)
            figures, before = figures + own, found
            if rung == _TOP and role == TUNED:
                tracks += [row["tracks"] for row in record["truth"] if row["tracks"]]
    if tracks:
        of = f"{len(tracks)} true objects with a track"
        figures.append(figure("masks_tracks_per_object", sum(tracks) / len(tracks), "", "lower", of, role=TUNED))
    return figures


def _chosen(options: Options) -> dict[str, tuple[str, ...]]:
    ladder = (*LADDER, WITHOUT_HABITS, OTHER_RATES)
    if options.quick:
        return {"home": ("outlines", _TOP)}
    worlds = dict.fromkeys(TUNED_WORLDS, ladder) | dict.fromkeys((*REPORTED_WORLDS, "campus"), (_TOP, OTHER_RATES))
    chosen: dict[str, tuple[str, ...]] = {}
    for text in options.only:
        world, _, rung = text.partition(":")
        if world not in worlds or rung not in ("", *ladder):
            raise InputError(f"--only {text}: expected WORLD[:RUNG] of {', '.join(worlds)}; {', '.join(ladder)}")
        chosen[world] = chosen.get(world, ()) + ((rung,) if rung else worlds[world])
    return chosen or worlds


def _mapped(log: WorldLog, shared: Path, rung: str, seed: int) -> dict[str, Any]:
    config = read_config(MapperConfig, None, (NO_SHAPES,))
    segmenter = segmenter_with_errors(shared, load_truth(log.truth), rung, seed, config.perception)
    with tempfile.TemporaryDirectory() as folder:
        return mapped(log.log, log.truth, Path(folder) / "map", config, segmenter=segmenter)
