"""Boxes labelled by hand as truth: a JSON file, or `boxes.json` in a folder.

`upright_from_world` (3x3) turns the world of the poses z up, as the player does: boxes are then in the map's world.
Each of `objects` has `id`, `center`, `size` (along, across, up), `yaw` from the x axis of the upright world; optional
are `name` or `kind`, `ignore`, and `seen_center` with `seen_size` for the part that the log shows.
"""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.confined import whole_number
from hickory_stream.errors import RecordingError
from hickory_stream.evaluation.match import SURFACE_REACH_M, Score, TrueBox, score_of
from hickory_stream.geometry.boxes import OrientedBox
from hickory_stream.geometry.mesh import Mesh
from hickory_stream.geometry.rigid import from_rotation_translation, is_rigid, yaw_rotation
from hickory_stream.records import MapSnapshot

LABELS_FILE = "boxes.json"
# Shares of points that differ by less are equal: the smaller box decides.
_SHARE_SLACK = 0.05


def load_labels(path: Path) -> tuple[TrueBox, ...]:
    """Return the labelled boxes of a file or folder in the upright world; raises `RecordingError`."""
    file = path / LABELS_FILE if path.is_dir() else path
    try:
        record = json.loads(file.read_bytes())
        if not isinstance(record, dict) or record.get("format") != 1 or not isinstance(record.get("objects"), list):
            raise ValueError("expected `format` 1 and a list `objects`")
        upright_from_world = _numbers(record, "upright_from_world", (3, 3))
        if not is_rigid(from_rotation_translation(upright_from_world, np.zeros(3))):
            raise ValueError("`upright_from_world` is no rotation")
        labels = tuple(_label(i, row, upright_from_world) for i, row in enumerate(record["objects"]))
    except OSError as error:
        raise RecordingError(f"{file} cannot be read: {error.strerror}") from error
    except (ValueError, RecursionError) as error:
        raise RecordingError(f"{file} is no file of labelled boxes: {error}") from error
    if len({label.id for label in labels}) < len(labels) or not any(label.counts for label in labels):
        raise RecordingError(f"{file} needs objects of different `id`, at least one of them without `ignore`")
    return labels


def score_labels(
    snapshot: MapSnapshot,
    meshes: Mapping[int, Mesh],
    labels: Sequence[TrueBox],
    depth_on: Mapping[int, int] | None = None,
) -> Score:
    """Return the score of a map against labelled boxes; `meshes` holds layer 2 by object id, in the object frames."""
    return score_of(
        labels, snapshot, meshes, depth_on, owner_of=lambda tracked: _owner(tracked.points_world, labels),
        is_structure=lambda _: False,
    )  # fmt: skip


def _owner(points_world: NDArray[np.float32], labels: Sequence[TrueBox]) -> int | None:
    # The smallest box that holds more than half of the points: what stands in a shelf is not the shelf.
    shares = [max(box.contains(points_world, SURFACE_REACH_M).mean() for box in label.boxes) for label in labels]
    least = max(0.5, max(shares) - _SHARE_SLACK)
    holding = [label for label, share in zip(labels, shares, strict=True) if share > least]
    return min(holding, key=lambda label: label.boxes[0].volume_m3).id if holding else None


def _label(index: int, row: Any, upright_from_world: NDArray[np.float64]) -> TrueBox:
    try:
        if not isinstance(row, dict):
            raise ValueError("expected keys and values")
        turn, boxes = yaw_rotation(float(_numbers(row, "yaw", ()))), []
        for part in ("", "seen_") if "seen_size" in row else ("",):
            center, size = (_numbers(row, part + key, (3,)) for key in ("center", "size"))
            if not (size > 0).all():
                raise ValueError(f"found `{part}size` {row[part + 'size']}, expected lengths above 0")
            place = from_rotation_translation(turn, upright_from_world @ center)
            boxes.append(OrientedBox(world_from_box=place, half_extents_m=size / 2))
        name, number = str(row.get("name", row.get("kind", "object"))), whole_number(row.get("id"), "`id`")
        return TrueBox(id=number, kind=name, counts=not row.get("ignore", False), boxes=tuple(boxes))
    except ValueError as error:
        raise ValueError(f"objects[{index}]: {error}") from error


def _numbers(row: dict[str, Any], key: str, shape: tuple[int, ...]) -> NDArray[np.float64]:
    try:
        numbers = np.array(row.get(key), dtype=np.float64)
    except (TypeError, ValueError):
        numbers = np.array(np.nan)
    if numbers.shape != shape or not np.isfinite(numbers).all():
        found = f"`{key}` {str(row[key])[:40]}" if key in row else f"no `{key}`"
        wanted = {(): "a number", (3,): "three numbers"}.get(shape, "three rows of three numbers")
        raise ValueError(f"found {found}, expected {wanted}")
    return numbers
