"""The generalisation gate: rooms by others, real frames and fresh seeds of our worlds, with oracle ablations."""
# `office`, `warehouse`, the kitchen and the clouds of `mosd_report` are for reporting alone; the others tune. Exact
# odometry, 5 Hz, 60 s.

import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tools.benchmarks.common.cached_runs import cached
from tools.benchmarks.common.code_hashes import MAPS, code_hash
from tools.benchmarks.common.figures import Figure, Options
from tools.benchmarks.foreign.figures import figures_of, of_map, reasons
from tools.benchmarks.foreign.logs import WorldLog, foreign_log, jackal_log, outdoor_log, own_log, worlds_folder
from tools.benchmarks.foreign.parts import JACKAL, OUTDOORS, OWN, ROLES, Part, chosen_parts
from tools.benchmarks.foreign.runs import clouds_scored, kitchen_scored, mapped_on, timed

_QUICK_S = 12.0
_SEEDS = 100_000
_SUMMARY = ("recall_25", "reachable_recall_25", "precision_25", "generated_share", "invented_volume")
_SCORES = ("hickory_stream/evaluation", "tools/benchmarks/foreign/runs.py")


def measure(options: Options) -> list[Figure]:
    """Return the figures of the chosen parts; parts that did not begin in time are printed, and absent."""
    # A quick run plays the first seconds of `home` alone: its figures have names of their own.
    worlds = worlds_folder(options.worlds)
    if options.quick:
        log = foreign_log(worlds, "home", "A", "hand", _QUICK_S)
        return of_map("quick_home", _mapped(log, "ours"), ROLES["home"])
    until = time.monotonic() + 60 * options.minutes
    code = code_hash(*MAPS)
    seeds, code = own_seeds(options.seed, code), code_hash(*MAPS, *_SCORES)
    outdoors = ", ".join(map(str, seeds[: len(OUTDOORS)]))
    print(f"code {code[:12]}; apartments {', '.join(map(str, seeds))}; streets {outdoors}", flush=True)
    measured: dict[Part, dict[str, Any]] = {}
    late = []
    for part in chosen_parts(options.only):
        may_begin = time.monotonic() < until
        key, measure_part = _work(part, worlds, seeds, may_render=may_begin)
        file = options.state / f"foreign-{code[:12]}" / f"{part.name.replace(':', '-')}-{key}.json"
        if options.fresh:
            file.unlink(missing_ok=True)
        if may_begin or file.is_file():
            measured[part] = cached(file, lambda part=part, work=measure_part: _reported(part, work))
        else:
            late.append(part.name)
    if late:
        print(f"not measured for want of time: {', '.join(late)}")
    return figures_of(measured)


def own_seeds(seed: int, code: str) -> tuple[int, ...]:
    first = seed * len(OWN) if seed else int(code[:8], 16) % _SEEDS
    # Beyond every seed that anything was trained or tuned on.
    return tuple(_SEEDS + first + i for i in range(len(OWN)))


def _work(
    part: Part, worlds: Path, seeds: tuple[int, ...], *, may_render: bool
) -> tuple[str, Callable[[], dict[str, Any]]]:
    data = worlds.parent / "data"
    if part.world in OWN:
        seed = seeds[OWN.index(part.world)]
        return str(seed), lambda: _mapped(own_log(seed))
    if part.world in OUTDOORS:
        seed = seeds[OUTDOORS.index(part.world)]
        return str(seed), lambda: _mapped(outdoor_log(seed))
    if part.world == "clouds_tuned":
        return "data", lambda: clouds_scored(data / "mosd")
    if part.world == "clouds_report":
        return "data", lambda: clouds_scored(data / "mosd_report")
    if part.world == "kitchen":
        return "data", lambda: kitchen_scored(data, worlds.parent / "score_boxes.py")
    if not may_render:
        return "", dict
    if part.camera == JACKAL:
        log = jackal_log(worlds, part.world)
    else:
        log = foreign_log(worlds, *((part.world, part.walk, part.camera) if part.walk else ("home", "A", "hand")))
    return log.key, lambda: timed(log.log) if part.world == "speed" else _mapped(log, part.rung)


def _mapped(log: WorldLog, rung: Any = "ours") -> dict[str, Any]:
    with tempfile.TemporaryDirectory() as temporary:
        return mapped_on(rung, (log.log, *log.beside), log.truth, Path(temporary) / "map")


def _reported(part: Part, work: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    print(f"{part.name}: measuring", flush=True)
    started = time.monotonic()
    record = work()
    summary = "done"
    if part.is_map:
        print("\n".join(f"  {line}" for line in reasons(record)), flush=True)
        figures = {one.name.removeprefix(f"{part.world}_"): one.value for one in of_map(part.world, record, "")}
        summary = ", ".join(f"{name} {figures[name]:.3f}" for name in _SUMMARY if name in figures)
    print(f"{part.name}: {summary} ({time.monotonic() - started:.0f} s)", flush=True)
    return record
