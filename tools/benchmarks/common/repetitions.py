"""Records of repetitions in a file, a JSON object a line, so that a measurement can be stopped and continued."""
# A measurement is a folder named by a hash of the code that it measures: records of different code are never mixed.

import fcntl
import json
import shutil
import time
from collections.abc import Iterator
from datetime import UTC, datetime
from io import TextIOWrapper
from pathlib import Path
from typing import Any

from hickory_stream.base.json_text import dumps_exactly
from tools.benchmarks.common.code_hashes import code_hash, commit_of_the_code

CODE = ("requirements.lock", "hickory_stream", "players", "tools/benchmarks")


class Repetitions:
    """The records of one part, in `file` or in memory alone; one process at a time appends to a file."""

    # `until` is the moment of `time.monotonic` after which no repetition begins.

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
        return time.monotonic() >= self._until

    def missing(self, number: int) -> Iterator[int]:
        """Yield the index of the next repetition until there are so many records, or the time is up."""
        while len(self.records) < number and not self.is_time_up:
            yield len(self.records)

    def add(self, **record: Any) -> None:
        self.records.append(record)
        if self._file is not None:
            self._file.write(dumps_exactly(record) + "\n")
            self._file.flush()

    def close(self) -> None:
        if self._file is not None:
            self._file.close()


def measurement_folder(state: Path, name: str, *, seed: int, fresh: bool) -> Path:
    """Return the folder of a measurement of the present code, made if there is none; `about.json` describes it."""
    code = code_hash(*CODE)
    folder = state / f"{name}-{code[:12]}-seed{seed}"
    if fresh and folder.exists():
        shutil.rmtree(folder)
    folder.mkdir(parents=True, exist_ok=True)
    about = folder / "about.json"
    if not about.exists():
        begun = datetime.now(tz=UTC).isoformat(timespec="seconds")
        about.write_text(dumps_exactly({"begun": begun, "commit": commit_of_the_code(), "code": code}, indent=1) + "\n")
    return folder


def _whole_lines(file: TextIOWrapper) -> list[dict[str, Any]]:
    file.seek(0)
    text = file.read()
    whole = text[: text.rfind("\n") + 1]
    if whole != text:
        file.truncate(len(whole.encode()))
    return [json.loads(line) for line in whole.splitlines()]
