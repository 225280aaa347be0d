"""Ablation of each special rule, the count of hand-set numbers, and their sensitivity.

On `home` and `bookstore`, walk A by hand, which are for tuning, and on own apartments for the ablation: layer 1 with
one rule switched, or one number changed by a fifth. Perception is done again with the map as it becomes; numbers of
the mapping are changed over what was perceived once (`rule_logs`), except those of the lattice and of the observed
space, which perception reads. A number that is compiled into a function is counted, and not changed.
"""

from __future__ import annotations

import time
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

from hickory_stream.config import MapperConfig
from hickory_stream.errors import InputError
from tools.benchmarks.figures import Figure
from tools.benchmarks.foreign_logs import foreign_log, own_log, worlds_folder
from tools.benchmarks.repetitions import Repetitions, measurement_folder
from tools.benchmarks.rule_constants import constants, inline_numbers, moved, with_constant
from tools.benchmarks.rule_logs import Counts, RuleLog
from tools.benchmarks.rule_switches import RULES

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence
    from contextlib import AbstractContextManager
    from pathlib import Path

    from tools.benchmarks.figures import Options
    from tools.benchmarks.foreign_logs import WorldLog
    from tools.benchmarks.rule_constants import Constant
    from tools.benchmarks.rule_switches import Rule, Way

PARTS = ("rules", "mapping", "perception")
TUNED = ("home", "bookstore")
OWN = (24, 30)
_BY = 0.2
_KNIFE_EDGE = 0.02
# For each of the numbers on every second keyframe: there are hundreds of changes.
_STEP = 2
# What perception reads of the map: a change of it changes what is perceived.
_READ_BY_PERCEPTION = ("mapping.lattice.", "mapping/entities/observed_space.py")
_BASELINE = "as it is"


@dataclass(frozen=True, slots=True)
class _Change:
    """One thing changed: its name, how to have it so, and how a log is played with it."""

    name: str
    made: Callable[[MapperConfig], AbstractContextManager[MapperConfig]]
    way: Way


def measure(options: Options) -> list[Figure]:
    """Return the counts, the ablation and the knife-edges, as far as they were measured; `--only` names `PARTS`.

    Each change of each log is kept under `--state` by the hash of the code; a later call goes on. A quick run counts
    the numbers alone.

    Raises:
        InputError: there is no such part.
        HickoryError: a log is not there, or is not as it must be.
    """
    unknown = set(options.only) - set(PARTS)
    if unknown:
        raise InputError(f"--only {' '.join(sorted(unknown))}: no such part; expected {', '.join(PARTS)}")
    figures = _counted()
    if options.quick:
        return figures
    folder = measurement_folder(options.state, "rules", seed=0, fresh=options.fresh)
    until = time.monotonic() + 60 * options.minutes
    for part in options.only or PARTS:
        logs = _logs(options.worlds, with_own=part == "rules")
        changes = _changes(part)
        measured = _measured(folder, part, logs, changes, until=until)
        figures += ablation(measured) if part == "rules" else sensitivity(part, measured, len(changes))
    return figures


def ablation(measured: Mapping[str, Mapping[str, Counts]]) -> list[Figure]:
    """Return what is found without each rule, less what is found as it is, and print the table.

    `measured` has the counts of each log by what was changed and by the log's name.
    """
    figures: list[Figure] = []
    rows = []
    before = measured.get(_BASELINE, {})
    for rule in RULES:
        after = measured.get(rule.name, {})
        logs = sorted(before.keys() & after.keys(), key=list(before).index)
        if not logs:
            continue
        found = {
            log: (after[log].found_25 - before[log].found_25, _false(after[log]) - _false(before[log])) for log in logs
        }
        found_50 = sum(after[log].found_50 - before[log].found_50 for log in logs)
        rows.append((rule, found, found_50))
        of = f"{sum(after[log].found_25 for log in logs)} of {sum(after[log].truth for log in logs)} true objects"
        worth = -sum(right for right, _ in found.values()) if rule.is_on else sum(right for right, _ in found.values())
        figures.append(
            Figure(name=f"worth {rule.name}", value=worth, unit="objects", better="same", of=of, role=", ".join(logs))
        )
    if rows:
        _print_ablation(before, rows)
    return figures


def sensitivity(part: str, measured: Mapping[str, Mapping[str, Counts]], num_changes: int) -> list[Figure]:
    """Return how many numbers move recall by more than `_KNIFE_EDGE` if changed by a fifth, and print them."""
    before = _total(measured.get(_BASELINE, {}), TUNED)
    if before is None:
        return []
    edges: dict[str, list[str]] = {}
    done = 0
    for name, counts in measured.items():
        after = _total(counts, TUNED)
        if name == _BASELINE or after is None:
            continue
        done += 1
        by = (after.found_25 - before.found_25) / before.truth
        if abs(by) > _KNIFE_EDGE:
            number, _, change = name.partition(" ")
            edges.setdefault(number, []).append(
                f"{change}: recall {by:+.3f}, false objects {_false(after) - _false(before):+d}"
            )
    print(f"\nknife-edges of {part}: recall {before.found_25} of {before.truth}, {before.objects} objects, as it is")
    for number, told in sorted(edges.items()):
        print(f"  {number} {'; '.join(told)}")
    tried = f"{done} of {num_changes} changes by {_BY:.0%}, on {' and '.join(TUNED)}"
    return [Figure(name=f"knife_edges_{part}", value=len(edges), unit="numbers", better="lower", of=tried)]


def _counted() -> list[Figure]:
    every = [constant for constant in constants() if constant.decides]
    configured = sum(constant.is_configured for constant in every)
    inline = len(inline_numbers())

    def figure(name: str, value: int, of: str) -> Figure:
        return Figure(name=name, value=value, unit="numbers", better="lower", of=of)

    return [
        figure("num_constants", len(every), "those that decide, of the configuration and of modules"),
        figure("num_constants_configured", configured, "those of the configuration"),
        figure("num_constants_inline", inline, "numbers with a fraction within functions, which have no name"),
    ]


def _changes(part: str) -> list[_Change]:
    if part == "rules":
        return [_of_rule(rule) for rule in RULES]
    return [
        _of_constant(constant, by)
        for constant in constants()
        if constant.decides and constant.package == part and not constant.is_compiled
        for by in (-_BY, _BY)
        if moved(constant, by) != constant.value
    ]


def _of_rule(rule: Rule) -> _Change:
    return _Change(rule.name, rule.switched, rule.way)


def _of_constant(constant: Constant, by: float) -> _Change:
    value = moved(constant, by)

    @contextmanager
    def made(config: MapperConfig) -> Iterator[MapperConfig]:
        with with_constant(config, constant, value) as changed:
            yield changed

    is_surface = constant.name.startswith(("perception.geometric.surface.", "perception/surface.py"))
    is_read = constant.package == "perception" or constant.name.startswith(_READ_BY_PERCEPTION)
    way: Way = "perceived"
    if is_read:
        way = "anew" if is_surface else "prepared"
    return _Change(f"{constant.key} {constant.value:g} -> {value:g}", made, way)


def _logs(worlds: Path | None, *, with_own: bool) -> dict[str, Callable[[], WorldLog]]:
    folder = worlds_folder(worlds)
    logs: dict[str, Callable[[], WorldLog]] = {
        world: lambda world=world: foreign_log(folder, world, "A", "hand")  # type: ignore[misc]
        for world in TUNED
    }
    if with_own:
        logs |= {f"own{seed}": lambda seed=seed: own_log(seed) for seed in OWN}  # type: ignore[misc]
    return logs


def _measured(
    folder: Path,
    part: str,
    logs: Mapping[str, Callable[[], WorldLog]],
    changes: Sequence[_Change],
    *,
    until: float,
) -> dict[str, dict[str, Counts]]:
    """Return the counts by change and log: what is kept, and what there is time for."""
    config = MapperConfig()
    kept = Repetitions(folder / f"{part}.jsonl", until=until)
    try:
        measured: dict[str, dict[str, Counts]] = {_BASELINE: {}}
        for record in kept.records:
            measured.setdefault(record["change"], {})[record["log"]] = Counts(**record["counts"])
        for name, log in logs.items():
            missing = [change for change in changes if name not in measured.get(change.name, {})]
            if not missing or kept.is_time_up:
                continue
            print(f"{part}: {name}, {len(missing)} changes", flush=True)
            played = RuleLog(log(), config, 1 if part == "rules" else _STEP)
            if name not in measured[_BASELINE]:
                measured[_BASELINE][name] = played.baseline
                kept.add(change=_BASELINE, log=name, counts=asdict(played.baseline))
            for i, change in enumerate(missing):
                if kept.is_time_up:
                    break
                with change.made(config) as changed:
                    counts = played.counts(changed, change.way)
                measured.setdefault(change.name, {})[name] = counts
                kept.add(change=change.name, log=name, counts=asdict(counts))
                by = counts.found_25 - played.baseline.found_25
                print(f"  {i + 1}/{len(missing)} {change.name}: {counts.found_25} ({by:+d})", flush=True)
        return measured
    finally:
        kept.close()


def _false(counts: Counts) -> int:
    return counts.objects - counts.found_25


def _total(counts: Mapping[str, Counts], logs: Sequence[str]) -> Counts | None:
    """Return the counts of all of the logs together, None where one is missing."""
    if any(log not in counts for log in logs):
        return None
    first, *others = (counts[log] for log in logs)
    for other in others:
        first = first + other
    return first


def _print_ablation(
    before: Mapping[str, Counts], rows: Sequence[tuple[Rule, Mapping[str, tuple[int, int]], int]]
) -> None:
    """Print a row for each rule: what is found and what is false without it, more (+) or less (-) than as it is."""
    print("\n| rule | " + " | ".join(before) + " | at 0.5 |\n|---|" + "---|" * (len(before) + 1))
    told = [f"{counts.found_25} of {counts.truth}, {_false(counts)} false" for counts in before.values()]
    print(f"| {_BASELINE} | {' | '.join(told)} | {sum(counts.found_50 for counts in before.values())} |")
    for rule, found, found_50 in rows:
        cells = [f"{found[log][0]:+d}, {found[log][1]:+d}" if log in found else "" for log in before]
        name = rule.name if rule.is_on else f"{rule.name} (on)"
        print(f"| {name} | {' | '.join(cells)} | {found_50:+d} |")
