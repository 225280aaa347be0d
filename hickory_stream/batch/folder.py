"""The folder of a batch: its logs, options and outcomes, for resumption.

`batch.json` is written first, `outcomes/NAME.json` after each log, atomically.
"""

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from hickory_stream.base.atomic_files import disk_errors, write_atomically
from hickory_stream.base.json_text import dumps
from hickory_stream.batch.tasks import LogOutcome
from hickory_stream.errors import InputError, MapFolderError
from hickory_stream.map_folder.layout import FolderLock

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
