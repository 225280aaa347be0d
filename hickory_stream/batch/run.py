"""A batch from its start or resumption to its table, with the overlaps and merged maps."""

from __future__ import annotations

import hashlib
import json
import os
import time
from collections.abc import Mapping
from contextlib import closing
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hickory_stream.alignment.answer import Alignment
from hickory_stream.base.atomic_files import disk_errors, write_atomically
from hickory_stream.base.json_text import dumps
from hickory_stream.batch.executors import outcomes_here, outcomes_on
from hickory_stream.batch.place_signature import candidate_pairs, place_signatures
from hickory_stream.batch.result import BatchResult, Joined, Overlap, Row
from hickory_stream.batch.tasks import LogOutcome, LogTask, names_of, software
from hickory_stream.errors import InputError, MapFolderError, WorkerError
from hickory_stream.fleet.finish import finish
from hickory_stream.map_folder.layout import FolderLock
from players import SourceOptions, make_source_note

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterable, Mapping, Sequence

    from hickory_stream.alignment.object_map import ObjectMap
    from hickory_stream.config import MapperConfig
    from hickory_stream.sinks.disk_sink import DiskSinkConfig


MERGED = "merged"
"""What the merged maps of a batch are called."""


def join_maps(folders: Mapping[str, Path], out: Path, tell: Callable[[str], None]) -> Joined:
    """Align maps that may overlap, and merge overlapping ones into OUT/merged.map, merged-2.map, ...

    Raises `MapFolderError` for a merged map.
    """
    sizes: list[float] = []

    def choose(maps: Sequence[ObjectMap]) -> Iterable[tuple[int, int]]:
        signatures = place_signatures(maps)
        sizes.extend(one.num_bytes / 1e3 for one in signatures)
        return candidate_pairs(signatures)

    finished = finish(folders, out, overwrite=True, tell=tell, choose=choose, name=MERGED)
    believed = {pair for frame in finished.frames for pair in frame.pairs}
    overlaps = tuple(
        Overlap(
            a=pair[0],
            b=pair[1],
            is_believed=pair in believed,
            num_pairs=len(answer.pairs) if isinstance(answer, Alignment) else 0,
            told="" if isinstance(answer, Alignment) else f"{answer.refusal.value}: {answer.reason}",
        )
        for pair, answer in finished.answers.items()
    )
    count = len(finished.maps)
    return Joined(
        num_pairs=count * (count - 1) // 2,
        overlaps=overlaps,
        merged=finished.merged,
        signature_kb=float(np.mean(sizes)) if sizes else 0.0,
        problems=tuple(f"{name}: {why}" for name, why in finished.problems.items()),
    )


_FULL = "the disk is full: free space, then continue with the same command"


@dataclass(frozen=True, kw_only=True, slots=True)
class BatchPlan:
    """Plan of a batch: `workers` processes here (0: one a processor) or a `cluster`; `merges` joins the maps."""

    uris: tuple[str, ...]
    options: SourceOptions
    out: Path
    mapper: MapperConfig
    disk: DiskSinkConfig
    workers: int = 0
    cluster: str = ""
    merges: bool = False
    anyway: bool = False


def run_batch(plan: BatchPlan, tell: Callable[[str], None] = lambda text: None) -> BatchResult:
    """Map the remaining logs and merge; `tell` gets events as sentences.

    A log that cannot be mapped becomes a row with the reason; on a full disk no further log begins. Raises `InputError`
    for a missing log or another batch's folder, `MapFolderError` for the folder, `ConfigError` for the cluster.
    """
    missing = [uri for uri in plan.uris if not Path(uri).exists()]
    if missing:
        raise InputError(f"there is no log {missing[0]}; give files or folders that are there")
    started_s = time.monotonic()
    names = names_of(plan.uris)
    folder = BatchFolder(plan.out, _told_plan(plan, names))
    try:
        before = {name: outcome for name in names if (outcome := folder.outcome(name)) is not None}
        tasks = [
            _task(plan, folder, name, uri) for name, uri in zip(names, plan.uris, strict=True) if name not in before
        ]
        if before:
            tell(f"{len(before)} of {len(names)} logs were mapped before")
        outcomes, stopped = _outcomes(plan, folder, tasks, tell)
        rows = tuple(_row(folder, name, uri, before, outcomes) for name, uri in zip(names, plan.uris, strict=True))
        joined = None
        if plan.merges and not stopped:
            maps = {name: Path(row.map) for name, row in zip(names, rows, strict=True) if row.state == "mapped"}
            joined = join_maps(maps, plan.out, tell)
    finally:
        folder.release()
    return BatchResult(out=plan.out, rows=rows, wall_s=time.monotonic() - started_s, joined=joined, stopped=stopped)


def _outcomes(
    plan: BatchPlan, folder: BatchFolder, tasks: Sequence[LogTask], tell: Callable[[str], None]
) -> tuple[dict[str, LogOutcome], str]:
    found: dict[str, LogOutcome] = {}
    with closing(_worked(plan, tasks)) as outcomes:
        try:
            for outcome in outcomes:
                found[outcome.name] = outcome
                if outcome.state == "mapped":
                    folder.keep(outcome)
                tell(f"{len(found)} of {len(tasks)}: {_sentence(outcome)}")
                if outcome.state == "disk full":
                    return found, _FULL
        except (WorkerError, MapFolderError) as error:
            return found, str(error)
        except KeyboardInterrupt:
            return found, "stopped; continue with the same command"
    return found, ""


def _worked(plan: BatchPlan, tasks: Sequence[LogTask]) -> Generator[LogOutcome, None, None]:
    if not tasks:
        yield from ()
    elif plan.cluster:
        yield from outcomes_on(plan.cluster, tasks)
    else:
        yield from outcomes_here(tasks, min(plan.workers or os.cpu_count() or 1, len(tasks)))


def _task(plan: BatchPlan, folder: BatchFolder, name: str, uri: str) -> LogTask:
    return LogTask(
        name=name,
        note=make_source_note([uri], plan.options),
        out=folder.map_path(name).resolve(),
        mapper=plan.mapper,
        disk=plan.disk,
        software=software(),
        anyway=plan.anyway,
    )


def _row(
    folder: BatchFolder, name: str, uri: str, before: dict[str, LogOutcome], outcomes: dict[str, LogOutcome]
) -> Row:
    outcome = before.get(name) or outcomes.get(name)
    if outcome is None:
        outcome = LogOutcome(name=name, state="failed", reason="not begun, or left as it was")
    return Row(**asdict(outcome), log=uri, map=str(folder.map_path(name)), was_there=name in before)


def _told_plan(plan: BatchPlan, names: Sequence[str]) -> dict[str, Any]:
    # Identifies a batch; the way of execution is no part of it.
    config = asdict(plan.mapper)
    del config["run"]
    made = dumps([config, asdict(plan.disk), {**make_source_note([], plan.options)}], sort_keys=True)
    logs = {
        name: {"path": str(Path(uri).absolute()), "bytes": _num_bytes(Path(uri))}
        for name, uri in zip(names, plan.uris, strict=True)
    }
    return {"software": software(), "config": hashlib.sha256(made.encode()).hexdigest()[:16], "logs": logs}


def _num_bytes(path: Path) -> int:
    if path.is_dir():
        return sum(one.stat().st_size for one in path.rglob("*") if one.is_file())
    return path.stat().st_size


def _sentence(outcome: LogOutcome) -> str:
    if outcome.state != "mapped":
        return f"{outcome.name}: {outcome.state}, see the table for the reason"
    went_on = ", gone on with" if outcome.resumed else ""
    return (
        f"{outcome.name}: {outcome.objects} objects of {outcome.keyframes} keyframes in {outcome.wall_s:.0f} s{went_on}"
    )


# The folder of a batch: its logs, options and outcomes, for resumption.
# `batch.json` is written first, `outcomes/NAME.json` after each log, atomically.
_KIND = "hickory-stream batch"
_PLAN = "batch.json"


class BatchFolder:
    """Holds a batch's folder until `release`, or the end of the process.

    Raises `MapFolderError` for a folder in use, another folder or a disk error, `InputError` for another batch.
    """

    def __init__(self, path: Path, plan: Mapping[str, Any]) -> None:
        self.path = path
        with disk_errors(path):
            if path.exists() and not (path / _PLAN).is_file() and any(path.iterdir()):
                raise MapFolderError(f"{path} is there and holds no batch; choose another --out")
            (path / "maps").mkdir(parents=True, exist_ok=True)
            (path / "outcomes").mkdir(exist_ok=True)
            self._lock = FolderLock(path)
        try:
            self._agree(plan)
        except BaseException:
            self._lock.release()
            raise

    def release(self) -> None:
        """Release the lock of the folder."""
        self._lock.release()

    def map_path(self, name: str) -> Path:
        """Return where the map of a log lies."""
        return self.path / "maps" / f"{name}.map"

    def outcome(self, name: str) -> LogOutcome | None:
        """Return the outcome of a log that is mapped; None otherwise."""
        try:
            outcome = LogOutcome(**json.loads((self.path / "outcomes" / f"{name}.json").read_bytes()))
        except (OSError, ValueError, TypeError):
            return None
        return outcome if self.map_path(name).is_dir() else None

    def keep(self, outcome: LogOutcome) -> None:
        """Store an outcome; raises `MapFolderError` on a disk error."""
        path = self.path / "outcomes" / f"{outcome.name}.json"
        with disk_errors(path):
            write_atomically(path, dumps(asdict(outcome), indent=1).encode())

    def _agree(self, plan: Mapping[str, Any]) -> None:
        path = self.path / _PLAN
        asked = {"kind": _KIND, **plan}
        if path.is_file():
            try:
                held = json.loads(path.read_bytes())
            except (OSError, ValueError) as error:
                raise MapFolderError(f"{path} is damaged: {error}; choose another --out") from error
            if not isinstance(held, dict) or held.get("kind") != _KIND:
                raise MapFolderError(f"{path} is no batch; choose another --out")
            for key, what in (("software", "by another version"), ("config", "with another configuration")):
                if held.get(key) != asked[key]:
                    raise InputError(f"{self.path} holds a batch made {what}; choose another --out")
            changed = [name for name, log in held["logs"].items() if asked["logs"].get(name) != log]
            if changed:
                raise InputError(
                    f"{self.path} holds a batch whose log {changed[0]} is another one, or has changed since; name the "
                    "same logs in the same order, and new ones after them, or choose another --out"
                )
            if held == asked:
                return
        with disk_errors(path):
            write_atomically(path, dumps(asked, indent=1).encode())
