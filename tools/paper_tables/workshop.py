"""The folder of a run: what was measured stays, so that the same command goes on where it stopped."""
# `results/` holds a JSON for every step with a key of its inputs; another key measures again. `hickory-stream play`
# makes a map in a process; an interrupted one starts again.

import json
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hickory_stream.base.atomic_files import write_atomically
from hickory_stream.base.json_text import dumps
from hickory_stream.errors import HickoryError, MapFolderError
from tools.benchmarks.common.code_hashes import code_hash
from tools.benchmarks.common.processes import ROOT

# What makes and measures maps.
_CODE = ("hickory_stream", "players", "tools/evaluation", "tools/paper_tables")


@dataclass(frozen=True, slots=True)
class Log:
    """A log of a data set: `files` are what is played, together one log, with `arguments` for `play`."""

    data_set: str
    scene: str
    name: str
    files: tuple[Path, ...]
    arguments: tuple[str, ...] = ()

    @property
    def label(self) -> str:
        return f"{self.data_set}-{self.scene}-{self.name}"


class Workshop:
    """Holds the folder of a run and tells where it is."""

    def __init__(self, folder: Path, workers: int | None, told: Callable[[str], None]) -> None:
        self.folder = folder
        self.told = told
        self._workers = workers
        self._code = code_hash(*_CODE)[:16]
        for part in ("results", "maps", "data"):
            (folder / part).mkdir(parents=True, exist_ok=True)

    def once(self, name: str, made_from: dict[str, Any], measure: Callable[[], Any]) -> Any:
        """Return what `measure` returned, as JSON, now or in an earlier run of the same code and input."""
        path = self.folder / "results" / f"{name}.json"
        key = {"code": self._code, **made_from}
        try:
            kept = json.loads(path.read_bytes())
            if kept["key"] == json.loads(dumps(key)):
                return kept["value"]
        except (OSError, ValueError, KeyError, TypeError):
            pass
        self.told(name)
        value = measure()
        write_atomically(path, dumps({"key": key, "value": value}, indent=1).encode())
        return json.loads(dumps(value))

    def map_of(self, log: Log) -> Path:
        """Return the folder of a log's map, playing the log if there is none yet."""
        # Raises MapFolderError: the log cannot be mapped; the text is that of the command.
        out = self.folder / "maps" / f"{log.label}.map"
        made_from = {"log": identity_of(log), "settings": list(log.arguments)}
        if not out.is_dir():
            (self.folder / "results" / f"map-{out.stem}.json").unlink(missing_ok=True)
        self.once(f"map-{out.stem}", made_from, lambda: self._play(log, out))
        return out

    def _play(self, log: Log, out: Path) -> float:
        arguments = list(log.arguments)
        if self._workers is not None:
            arguments += ["--workers", str(self._workers)]
        command = [sys.executable, "-m", "hickory_stream", "play", *map(str, log.files), "--out", str(out)]
        started = time.perf_counter()
        done = subprocess.run(
            [*command, "--overwrite", "--viewer", "none", "--json", *arguments],
            cwd=ROOT, text=True, capture_output=True, check=False,
        )  # fmt: skip
        if done.returncode:
            last = (done.stderr.strip().splitlines() or ["it said nothing"])[-1]
            raise MapFolderError(f"{log.label} cannot be mapped (exit status {done.returncode}): {last}")
        return time.perf_counter() - started


def identity_of(log: Log) -> list[Any]:
    """Return what tells a log from others: its files by name, number and size."""
    return [_identity(file) for file in log.files]


def _identity(file: Path) -> list[Any]:
    if file.is_file():
        return [file.name, 1, file.stat().st_size]
    sizes = [each.stat().st_size for each in sorted(file.rglob("*")) if each.is_file()]
    return [file.name, len(sizes), sum(sizes)]


def refusal(error: HickoryError) -> str:
    """Return why a cell of a table is empty: the first line of an error, short enough for a cell."""
    return str(error).splitlines()[0][:90]


@dataclass(frozen=True, kw_only=True, slots=True)
class Plan:
    """The sizes of a run; `seconds` are of synthetic logs and of walks through ReplicaCAD, None: the whole walk."""

    hope_scenes: int
    apartments: int
    robot_pairs: int
    nus_pairs: int
    hope_seconds: float
    apartment_seconds: float | None
    robot_seconds: float
    nus_seconds: float
    trials: int
    seeds: int


FULL = Plan(
    hope_scenes=3, apartments=4, robot_pairs=3, nus_pairs=1, hope_seconds=20.0, apartment_seconds=None,
    robot_seconds=60.0, nus_seconds=60.0, trials=100, seeds=5,
)  # fmt: skip
QUICK = Plan(
    hope_scenes=1, apartments=1, robot_pairs=1, nus_pairs=1, hope_seconds=10.0, apartment_seconds=24.0,
    robot_seconds=24.0, nus_seconds=20.0, trials=20, seeds=2,
)  # fmt: skip
