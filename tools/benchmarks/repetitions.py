"""Repetitions that go on where they were broken off: what each gave is written down before the next one begins.

A measurement of many repetitions is a folder, named by a hash of the code that it measures, so that results of
different code are never mixed. Each of its parts is a file with one JSON object a line; a line that was cut off is left
out.
"""

from __future__ import annotations

import ast
import fcntl
import functools
import hashlib
import json
import shutil
import subprocess
import time
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

from hickory_stream.base.json_text import dumps_exactly
from tools.benchmarks.processes import ROOT

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Iterator
    from io import TextIOWrapper
    from pathlib import Path

_CODE = ("hickory_stream", "players", "tools/benchmarks")
_KINDS = (".py", ".toml")


class Repetitions:
    """The records of one part, kept in `file` and added to by one process at a time; in memory alone without a file.

    `until` is the moment of `time.monotonic` after which no further repetition is begun.

    Raises:
        RuntimeError: another process is at the same part.
    """

    def __init__(self, file: Path | None = None, *, until: float = float("inf")) -> None:
        self.records: list[dict[str, Any]] = []
        self._until = until
        self._file: TextIOWrapper | None = None
        if file is not None:
            file.parent.mkdir(parents=True, exist_ok=True)
            self._file = file.open("a+", encoding="utf-8")
            try:
                fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError as error:
                self._file.close()
                raise RuntimeError(f"{file}: another process is at this part") from error
            self.records = _whole_lines(self._file)

    @property
    def is_time_up(self) -> bool:
        """Return whether no further repetition is to be begun."""
        return time.monotonic() >= self._until

    def missing(self, number: int) -> Iterator[int]:
        """Yield the index of the next repetition until there are so many records, or the time is up."""
        while len(self.records) < number and not self.is_time_up:
            yield len(self.records)

    def add(self, **record: Any) -> None:
        """Keep what a repetition gave."""
        self.records.append(record)
        if self._file is not None:
            self._file.write(dumps_exactly(record) + "\n")
            self._file.flush()

    def close(self) -> None:
        """Let another process at the part."""
        if self._file is not None:
            self._file.close()


def _whole_lines(file: TextIOWrapper) -> list[dict[str, Any]]:
    """Return the records of a file, and cut off a last line that was not written to its end."""
    file.seek(0)
    text = file.read()
    whole = text[: text.rfind("\n") + 1]
    if whole != text:
        file.truncate(len(whole.encode()))
    return [json.loads(line) for line in whole.splitlines()]


def measurement_folder(state: Path, name: str, *, seed: int, fresh: bool) -> Path:
    """Return the folder of a measurement of the present code, made if there is none; `about.json` says what it is."""
    code = code_hash()
    folder = state / f"{name}-{code[:12]}-seed{seed}"
    if fresh and folder.exists():
        shutil.rmtree(folder)
    folder.mkdir(parents=True, exist_ok=True)
    about = folder / "about.json"
    if not about.exists():
        begun = datetime.now(tz=UTC).isoformat(timespec="seconds")
        about.write_text(dumps_exactly({"begun": begun, "commit": commit_of_the_code(), "code": code}, indent=1) + "\n")
    return folder


def code_hash() -> str:
    """Return the sha256 of the sources of the packages, of the benchmarks and of the locked versions."""
    return hash_of_files(("requirements.lock", *_CODE), _KINDS)


@functools.cache
def product_hash() -> str:
    """Return the sha256 of what the packages do, comments and docstrings left out: what figures are measured of."""
    digest = hashlib.sha256()
    for path in _files_of(("hickory_stream", "players"), _KINDS):
        text = path.read_text(encoding="utf-8")
        digest.update(path.relative_to(ROOT).as_posix().encode())
        digest.update((syntax_of(text) if path.suffix == ".py" else text).encode())
    return digest.hexdigest()


def syntax_of(source: str) -> str:
    """Return a module's syntax tree without docstrings."""
    tree = ast.parse(source)
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef) and (
            ast.get_docstring(node, clean=False) is not None
        ):
            del node.body[0]
    return ast.dump(tree)


def hash_of_files(names: Iterable[str], suffixes: Collection[str]) -> str:
    """Return the sha256 of files of the checkout, and of those of its folders that end so, with their names."""
    digest = hashlib.sha256()
    for path in _files_of(names, suffixes):
        digest.update(path.relative_to(ROOT).as_posix().encode() + path.read_bytes())
    return digest.hexdigest()


def _files_of(names: Iterable[str], suffixes: Collection[str]) -> Iterator[Path]:
    for root in (ROOT / name for name in names):
        yield from [root] if root.is_file() else sorted(p for p in root.rglob("*") if p.suffix in suffixes)


def commit_of_the_code() -> str:
    """Return the commit that is checked out, marked where files differ from it; "unknown" without git."""
    try:
        asked = subprocess.run(
            ["git", "describe", "--always", "--dirty"], cwd=ROOT, capture_output=True, text=True, check=True
        )
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    return asked.stdout.strip()
