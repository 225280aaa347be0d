"""Damaged logs: every message outside the damage is read, none is silently wrong, and nothing crashes or hangs.

A case is a sound log of some container, a kind of damage and a seed. What must be read is known from the sound log and
the bytes that were touched.
"""

from __future__ import annotations

import tempfile
import time
from collections import Counter
from collections.abc import Iterable
from contextlib import closing
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from hickory_stream.errors import InputError
from players.damaging import KINDS, Kind, damaged, open_sound, parts_of, survivors
from players.opening import open_container
from tools.benchmarks.common.figures import Figure, Options, figure
from tools.benchmarks.common.repetitions import Repetitions, measurement_folder
from tools.benchmarks.logs.damaged_maps import figures_of as map_figures_of
from tools.benchmarks.logs.damaged_maps import run_map_cases
from tools.benchmarks.logs.small_logs import write_small_logs

_CASES, _QUICK_CASES = 1000, 160
_TOO_LONG_S = 20.0
# Bytes of a message that is altered are noticed where a checksum covers them; a ROS 1 bag without compression, its lz4
# as most writers make it, and SQLite have none.
_CHECKED = ("mcap_zstd", "mcap_lz4", "mcap_none", "bag_bz2")


@dataclass(slots=True)
class Tally:
    """What came of all cases."""

    cases: int = 0
    crashes: list[str] = field(default_factory=list)
    silent: list[str] = field(default_factory=list)
    unprotected: int = 0
    expected: int = 0
    recovered: int = 0
    worst: dict[str, list[int]] = field(default_factory=dict)


def measure(options: Options) -> list[Figure]:
    """Return the figures of all cases; of logs it prints the recovered share by container and kind."""
    repetitions = Repetitions()
    if not options.quick:
        name = "maps.jsonl" if options.maps else "logs.jsonl"
        kept = measurement_folder(options.state, "damage", seed=options.seed, fresh=options.fresh) / name
        repetitions = Repetitions(kept, until=time.monotonic() + 60.0 * options.minutes)
        print(f"kept in {kept}; {len(repetitions.records)} cases were there", flush=True)
    if options.maps:
        with closing(repetitions):
            altered = run_map_cases(_QUICK_CASES if options.quick else _CASES, options.seed, repetitions)
        for text in (*altered.crashes[:20], *altered.outside[:20]):
            print(f"  {text}")
        return map_figures_of(altered)
    with closing(repetitions):
        tally = run_cases(_QUICK_CASES if options.quick else _CASES, options.seed, repetitions)
    for name, (recovered, expected) in sorted(tally.worst.items()):
        print(f"  {name:<32} {recovered:>7} of {expected:>7} messages outside the damage")
    for text in (*tally.crashes[:10], *tally.silent[:10]):
        print(f"  {text}")
    return figures_of(tally)


def figures_of(tally: Tally) -> list[Figure]:
    """Return a tally as figures."""
    return [
        figure("damage_cases", tally.cases, "", "higher"),
        figure("damage_crashes", len(tally.crashes), "", "lower"),
        figure("damage_silent_errors", len(tally.silent), "", "lower"),
        figure("damage_recovered_fraction", tally.recovered / max(tally.expected, 1), "", "higher"),
        figure("damage_unprotected_altered", tally.unprotected, "messages", "lower"),
    ]


def run_cases(num_cases: int, seed: int, repetitions: Repetitions | None = None) -> Tally:
    """Return what came of so many cases, spread over all containers and kinds; those of `repetitions` are there."""
    repetitions = repetitions or Repetitions()
    with tempfile.TemporaryDirectory() as temporary:
        sound = write_small_logs(Path(temporary))
        truths = {name: (path.read_bytes(), parts_of(open_sound(path))) for name, path in sound.items()}
        names = sorted(truths)
        for i in repetitions.missing(num_cases):
            name, kind = names[i % len(names)], KINDS[i // len(names) % len(KINDS)]
            if name == "sqlite3" and kind == "shuffle":
                kind = "zero"  # pages are found by their numbers: in another order they are another file
            rng = np.random.default_rng([seed, i])
            target = Path(temporary) / f"case{sound[name].suffix}"
            case = Tally()
            _case(case, name, kind, truths[name], target, rng)
            repetitions.add(**asdict(case))
    return _sum(Tally(**record) for record in repetitions.records)


def _sum(cases: Iterable[Tally]) -> Tally:
    """Return what came of all of them."""
    tally = Tally()
    for case in cases:
        tally.cases += case.cases
        tally.crashes += case.crashes
        tally.silent += case.silent
        tally.unprotected += case.unprotected
        tally.expected += case.expected
        tally.recovered += case.recovered
        for group, (recovered, expected) in case.worst.items():
            share = tally.worst.setdefault(group, [0, 0])
            share[0] += recovered
            share[1] += expected
    return tally


def _case(
    tally: Tally, name: str, kind: Kind, truth: tuple[bytes, Any], target: Path, rng: np.random.Generator
) -> None:
    data, parts = truth
    broken, touched = damaged(data, parts, kind, rng)
    target.write_bytes(broken)
    left = Counter(survivors(parts, touched))
    known = Counter(message for part in parts for message in part.messages)
    tally.cases += 1
    started_s = time.monotonic()
    found: Counter[tuple[str, bytes]] = Counter()
    case = f"{name} {kind} ({touched[:2]})"
    try:
        log = open_container(target)
        for message in log.messages([topic.name for topic in log.topics]):
            found[message.topic, bytes(message.data)] += 1
    except InputError as error:
        if "\n" in str(error):
            tally.crashes.append(f"{case}: an error of several lines")
    except Exception as error:  # noqa: BLE001 # what is counted here
        tally.crashes.append(f"{case}: {type(error).__name__}: {error}")
    if time.monotonic() - started_s > _TOO_LONG_S:
        tally.crashes.append(f"{case}: took {time.monotonic() - started_s:.0f} s")
    wrong = sum((found - known).values())
    if wrong and name in _CHECKED:
        tally.silent.append(f"{case}: {wrong} messages that were never written")
    elif wrong:
        tally.unprotected += wrong
    recovered = sum((found & left).values())
    tally.expected += left.total()
    tally.recovered += recovered
    share = tally.worst.setdefault(f"{name} {kind}", [0, 0])
    share[0] += recovered
    share[1] += left.total()
