"""The generalisation gate: rooms that others made, real frames and fresh seeds of ours, with oracle experiments.

For tuning there are `home`, `bookstore`, own worlds and the clouds of `mosd`. `office`, `warehouse`, the kitchen and
the clouds of `mosd_report` are for reporting alone: nothing is chosen by them. Exact odometry, 5 Hz, 60 s. What was
measured is kept by log and by the code that makes maps, and not measured again.
"""

from __future__ import annotations

import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tools.benchmarks.foreign_figures import figures_of, of_map, reasons
from tools.benchmarks.foreign_logs import foreign_log, outdoor_log, own_log, worlds_folder
from tools.benchmarks.foreign_parts import OUTDOORS, OWN, ROLES, WORLDS, Part, Store, chosen_parts, map_code_hash
from tools.benchmarks.foreign_runs import clouds_scored, kitchen_scored, mapped, timed

if TYPE_CHECKING:
    from tools.benchmarks.figures import Figure, Options

_QUICK_S = 12.0
_SEEDS = 100_000


def measure(options: Options) -> list[Figure]:
    """Return the figures of the parts that are chosen; what was not measured for want of time is said, and absent.

    A quick run plays the first seconds of `home` alone: its figures have names of their own.

    Raises:
        HickoryError: the folder of worlds is not there, or a part is not as it must be.
    """
    worlds = worlds_folder(options.worlds)
    if options.quick:
        return _quick(worlds)
    until = time.monotonic() + 60 * options.minutes
    code = map_code_hash()
    store = Store(options.state, code)
    seeds = own_seeds(options.seed, code)
    outdoors = ", ".join(map(str, seeds[: len(OUTDOORS)]))
    print(f"code {code[:12]}; apartments {', '.join(map(str, seeds))}; streets {outdoors}", flush=True)
    measured: dict[Part, dict[str, Any]] = {}
    left = []
    for part in chosen_parts(options.only):
        record = _measured(part, worlds, store, seeds, is_fresh=options.fresh, may_begin=time.monotonic() < until)
        if record is None:
            left.append(part.name)
        else:
            measured[part] = record
    if left:
        print(f"not measured for want of time: {', '.join(left)}")
    return figures_of(measured)


def own_seeds(seed: int, code: str) -> tuple[int, ...]:
    """Return the seeds of the own worlds: drawn from the code, so that no code was made with them, or `seed` given."""
    first = seed * len(OWN) if seed else int(code[:8], 16) % _SEEDS
    # Beyond every seed that anything was trained or tuned on.
    return tuple(_SEEDS + first + i for i in range(len(OWN)))


def _measured(
    part: Part, worlds: Path, store: Store, seeds: tuple[int, ...], *, is_fresh: bool, may_begin: bool
) -> dict[str, Any] | None:
    """Return what is kept of a part, or what it gives now; None where it may not begin any more."""
    data = worlds.parent / "data"
    if part.world in ("clouds_tuned", "clouds_report", "kitchen"):
        key = "data"
    elif part.world in OWN:
        key = str(seeds[OWN.index(part.world)])
    elif part.world in OUTDOORS:
        key = str(seeds[OUTDOORS.index(part.world)])
    elif not may_begin:
        key = ""
    else:
        world, walk, camera = (part.world, part.walk, part.camera) if part.walk else ("home", "A", "hand")
        log = foreign_log(worlds, world, walk, camera)
        key = log.key
    kept = None if is_fresh else store.get(part, key)
    if kept is not None or not may_begin:
        return kept
    print(f"{part.name}: measuring", flush=True)
    started = time.monotonic()
    with tempfile.TemporaryDirectory() as temporary:
        out = Path(temporary) / "map"
        if part.world == "clouds_tuned":
            record = clouds_scored(data / "mosd")
        elif part.world == "clouds_report":
            record = clouds_scored(data / "mosd_report")
        elif part.world == "kitchen":
            record = kitchen_scored(data, worlds.parent / "score_boxes.py", out)
        elif part.world == "speed":
            record = timed(log.log)
        else:
            if part.world in OWN:
                log = own_log(int(key))
            elif part.world in OUTDOORS:
                log = outdoor_log(int(key))
            record = mapped(log.log, log.truth, part.rung, out)
    store.put(part, key, record)
    if part.world in (*WORLDS, *OWN, *OUTDOORS):
        print("\n".join(f"  {line}" for line in reasons(record)), flush=True)
    told = ", ".join(f"{f.name.removeprefix(part.world + '_')} {f.value:.3f}" for f in _headline(part, record))
    print(f"{part.name}: {told or 'done'} ({time.monotonic() - started:.0f} s)", flush=True)
    return record


def _headline(part: Part, record: dict[str, Any]) -> list[Figure]:
    if part.world not in (*WORLDS, *OWN, *OUTDOORS):
        return []
    names = (f"{part.world}_recall_25", f"{part.world}_precision_25")
    return [figure for figure in of_map(part.world, record, "") if figure.name in names]


def _quick(worlds: Path) -> list[Figure]:
    log = foreign_log(worlds, "home", "A", "hand", _QUICK_S)
    with tempfile.TemporaryDirectory() as temporary:
        record = mapped(log.log, log.truth, "ours", Path(temporary) / "map")
    return of_map("quick_home", record, ROLES["home"])
