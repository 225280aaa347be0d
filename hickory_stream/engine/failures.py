"""Failures while a map was made: shape jobs without a result, by reason, as the map folder keeps them."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import TYPE_CHECKING

from hickory_stream.confined import read_within
from hickory_stream.engine.jobs import FAILED, FAILURE
from hickory_stream.errors import HickoryError

if TYPE_CHECKING:
    from collections.abc import Collection
    from pathlib import Path

_UNKNOWN = "no reason was kept"


@dataclass(frozen=True, kw_only=True, slots=True)
class FailedShapes:
    """The objects whose latest shape job failed for one reason, and where the inputs of those jobs lie."""

    reason: str
    object_ids: tuple[int, ...]
    folders: tuple[Path, ...]


def failed_shapes(map_folder: Path, object_ids: Collection[int]) -> tuple[FailedShapes, ...]:
    """Return the failures of these objects by reason, the most frequent first."""
    by_reason: dict[str, list[int]] = {}
    folders = {object_id: map_folder / FAILED / f"{object_id:06d}" for object_id in sorted(object_ids)}
    for object_id, folder in folders.items():
        if folder.is_dir():
            by_reason.setdefault(_reason_in(folder), []).append(object_id)
    ordered = sorted(by_reason.items(), key=lambda item: (-len(item[1]), item[0]))
    return tuple(
        FailedShapes(reason=reason, object_ids=tuple(ids), folders=tuple(folders[i] for i in ids))
        for reason, ids in ordered
    )


def _reason_in(folder: Path) -> str:
    try:
        reason = json.loads(read_within(folder, FAILURE))["reason"]
    except (OSError, ValueError, KeyError, TypeError, RecursionError, HickoryError):
        return _UNKNOWN  # an input from before reasons were kept, or a damaged one
    return reason if isinstance(reason, str) else _UNKNOWN
