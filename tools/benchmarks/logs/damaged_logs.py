"""Damaged logs: every message outside the damage is read, none is silently wrong, and nothing crashes or hangs."""
# A case is a sound log of some container, a kind of damage and a seed. The messages that must be read are known from
# the sound log and the damaged bytes.

import tempfile
import time
from collections import Counter
from contextlib import closing
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from hickory_stream.errors import InputError
from players.opening import open_container
from tools.benchmarks.common.figures import Figure, Options, figure
from tools.benchmarks.common.repetitions import Repetitions, measurement_folder
from tools.benchmarks.logs import damaged_maps
from tools.damage.damaging import KINDS, Kind, damaged, open_sound, parts_of, survivors, write_small_logs

_CASES, _QUICK_CASES = 1000, 160
_TOO_LONG_S = 20.0
# Altered bytes of a message are noticed where a checksum covers them; a ROS 1 bag without compression, its lz4 as most
# writers make it, and SQLite have none.
_CHECKED = ("mcap_zstd", "mcap_lz4", "mcap_none", "bag_bz2")


@dataclass(slots=True)
class Tally:
    """The result of one case, or the sum of all; `worst` has recovered and expected messages by container and kind."""

    cases: int = 0
    crashes: list[str] = field(default_factory=list)
    silent: list[str] = field(default_factory=list)
    unprotected: int = 0
    expected: int = 0
    recovered: int = 0
    worst: dict[str, list[int]] = field(default_factory=dict)

    def add(self, case: "Tally") -> None:
        self.cases += case.cases
        self.crashes += case.crashes
        self.silent += case.silent
        self.unprotected += case.unprotected
        self.expected += case.expected
        self.recovered += case.recovered
        for group, counts in case.worst.items():
            self.worst[group] = [a + b for a, b in zip(self.worst.get(group, (0, 0)), counts, strict=True)]


def measure(options: Options) -> list[Figure]:
    """Return the figures of all cases; for logs, print the recovered share by container and kind."""
    num_cases = _QUICK_CASES if options.quick else _CASES
    repetitions = Repetitions()
    if not options.quick:
        folder = measurement_folder(options.state, "damage", seed=options.seed, fresh=options.fresh)
        file = folder / ("maps.jsonl" if options.maps else "logs.jsonl")
        repetitions = Repetitions(file, until=time.monotonic() + 60.0 * options.minutes)
        print(f"kept in {file}; {len(repetitions.records)} cases were there", flush=True)
    with closing(repetitions):
        if options.maps:
            return damaged_maps.figures_of(damaged_maps.run_map_cases(num_cases, options.seed, repetitions))
        tally = run_cases(num_cases, options.seed, repetitions)
    for name, (recovered, expected) in sorted(tally.worst.items()):
        print(f"  {name:<32} {recovered:>7} of {expected:>7} messages outside the damage")
    for text in (*tally.crashes[:10], *tally.silent[:10]):
        print(f"  {text}")
    return [
        figure("damage_cases", tally.cases),
        figure("damage_crashes", len(tally.crashes), "", "lower"),
        figure("damage_silent_errors", len(tally.silent), "", "lower"),
        figure("damage_recovered_fraction", tally.recovered / max(tally.expected, 1)),
        figure("damage_unprotected_altered", tally.unprotected, "messages", "lower"),
    ]


def run_cases(num_cases: int, seed: int, repetitions: Repetitions | None = None) -> Tally:
    """Return the result of so many cases, over all containers and kinds; those of `repetitions` are not repeated."""
    repetitions = repetitions or Repetitions()
    with tempfile.TemporaryDirectory() as temporary:
        sound = write_small_logs(Path(temporary))
        truths = {name: (path.read_bytes(), parts_of(open_sound(path))) for name, path in sound.items()}
        names = sorted(truths)
        for i in repetitions.missing(num_cases):
            name, kind = names[i % len(names)], KINDS[i // len(names) % len(KINDS)]
            if name == "sqlite3" and kind == "shuffle":
                kind = "zero"  # pages are found by their numbers: in another order they are another file
            target = Path(temporary) / f"case{sound[name].suffix}"
            case = _case(name, kind, truths[name], target, np.random.default_rng([seed, i]))
            repetitions.add(**asdict(case))
    tally = Tally()
    for record in repetitions.records:
        tally.add(Tally(**record))
    return tally


def _case(name: str, kind: Kind, truth: tuple[bytes, Any], target: Path, rng: np.random.Generator) -> Tally:
    data, parts = truth
    broken, touched = damaged(data, parts, kind, rng)
    target.write_bytes(broken)
    left = Counter(survivors(parts, touched))
    known = Counter(message for part in parts for message in part.messages)
    tally, case = Tally(cases=1), f"{name} {kind} ({touched[:2]})"
    started_s = time.monotonic()
    found: Counter[tuple[str, bytes]] = Counter()
    try:
        log = open_container(target)
        for message in log.messages([topic.name for topic in log.topics]):
            found[message.topic, bytes(message.data)] += 1
    except InputError as error:
        if "\n" in str(error):
            tally.crashes.append(f"{case}: an error of several lines")
    except Exception as error:  # noqa: BLE001 # counted here
        tally.crashes.append(f"{case}: {type(error).__name__}: {error}")
    if time.monotonic() - started_s > _TOO_LONG_S:
        tally.crashes.append(f"{case}: took {time.monotonic() - started_s:.0f} s")
    wrong = (found - known).total()
    if wrong and name in _CHECKED:
        tally.silent.append(f"{case}: {wrong} messages that were never written")
    elif wrong:
        tally.unprotected = wrong
    tally.expected, tally.recovered = left.total(), (found & left).total()
    tally.worst[f"{name} {kind}"] = [tally.recovered, tally.expected]
    return tally
