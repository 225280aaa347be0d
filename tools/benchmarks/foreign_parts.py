"""The parts of the gate: each is one measurement, kept by the hash of the code that makes maps.

A part is named by its world, walk, camera and rung (`home:A:hand:ours`), or by what else it measures (`kitchen`).
"""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from hickory_stream.base.json_text import dumps
from hickory_stream.errors import InputError
from tools.benchmarks.repetitions import hash_of_files
from tools.evaluation.oracle_ablation import RUNGS

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from tools.evaluation.oracle_ablation import Rung

TUNED_WORLDS, REPORTED_WORLDS = ("home", "bookstore"), ("office", "warehouse")
WORLDS = (*TUNED_WORLDS, *REPORTED_WORLDS)
OWN = ("own1", "own2", "own3")
OUTDOORS = ("outdoor1", "outdoor2")
WALKS, CAMERAS = ("A", "B"), ("hand", "robot")
TUNED, REPORTED = "tuned on", "reported"
ROLES = {
    **dict.fromkeys(TUNED_WORLDS, TUNED),
    **dict.fromkeys(REPORTED_WORLDS, REPORTED),
    **dict.fromkeys((*OWN, *OUTDOORS), "reported, fresh seeds of a generator that is tuned on"),
    "kitchen": REPORTED,
    "clouds_tuned": TUNED,
    "clouds_report": REPORTED,
}

# What a map and its figures depend on; the command line, sinks, paths and alignment are not among them.
_CODE = (
    "requirements.lock",
    "players",
    *(
        f"hickory_stream/{name}.py"
        for name in ("compiled", "config", "confined", "events", "json_text", "ports", "ranges", "records")
    ),
    *(
        f"hickory_stream/{name}"
        for name in (
            "alignment",
            "engine",
            "evaluation",
            "geometry",
            "graph",
            "loops",
            "mapping",
            "perception",
            "poses",
            "shapes",
            "worlds",
        )
    ),
    *(
        f"tools/benchmarks/{name}.py"
        for name in ("first_layer", "foreign_runs", "labelled_clouds", "mask_scores", "processes")
    ),
)
_KINDS = (".py", ".toml", ".npz", ".onnx", ".lock")


@dataclass(frozen=True, kw_only=True, slots=True)
class Part:
    """One thing to measure; `walk`, `camera` and `rung` are empty for what has none."""

    world: str
    walk: str = ""
    camera: str = ""
    rung: Rung = "ours"

    @property
    def name(self) -> str:
        """What it is called."""
        return ":".join((self.world, self.walk, self.camera, self.rung)) if self.walk else self.world


def all_parts() -> list[Part]:
    """Return the parts in the order in which they are measured: what most depends on comes first."""
    parts = [Part(world=world, walk="A", camera="hand") for world in WORLDS]
    parts += [Part(world=name) for name in ("clouds_tuned", "clouds_report", "kitchen", "speed", *OWN, *OUTDOORS)]
    parts += [Part(world=world, walk="A", camera="hand", rung=rung) for world in WORLDS for rung in RUNGS[1:]]
    others = [(walk, camera) for walk in WALKS for camera in CAMERAS if (walk, camera) != ("A", "hand")]
    return parts + [Part(world=world, walk=walk, camera=camera) for walk, camera in others for world in WORLDS]


def chosen_parts(only: Sequence[str]) -> list[Part]:
    """Return the parts that `only` names, all where it names none: `home`, `office:A`, `home:masks`, `own`, `clouds`.

    Raises:
        InputError: a name is that of no part.
    """
    names = [name for text in only for name in text.split(",") if name]
    parts = all_parts()
    if not names:
        return parts
    chosen: set[Part] = set()
    for name in names:
        found = [part for part in parts if _is_named(part, name)]
        if not found:
            raise InputError(
                f"--only {name}: no such part; expected WORLD[:WALK][:CAMERA][:RUNG] of worlds {', '.join(WORLDS)}, "
                f"walks A and B, cameras hand and robot, rungs {', '.join(RUNGS)}, "
                "or kitchen, clouds, own, outdoor, speed"
            )
        chosen.update(found)
    return [part for part in parts if part in chosen]


def _is_named(part: Part, name: str) -> bool:
    world, *rest = name.split(":")
    kind = part.world if part.world in WORLDS else part.world.split("_")[0].rstrip("123")
    return world in (part.world, kind) and set(rest) <= {part.walk, part.camera, part.rung}


class Store:
    """What was measured, one file for each part, log and code; the same is never measured twice."""

    def __init__(self, folder: Path, code: str) -> None:
        self._folder = folder / f"foreign-{code[:12]}"

    def get(self, part: Part, key: str) -> dict[str, Any] | None:
        """Return what is kept of a part and a log, None where nothing is."""
        try:
            record: dict[str, Any] = json.loads(self._file(part, key).read_text(encoding="utf-8"))
        except (FileNotFoundError, ValueError):
            return None
        return record

    def put(self, part: Part, key: str, record: dict[str, Any]) -> None:
        """Keep what was measured; a file is whole or absent."""
        file = self._file(part, key)
        file.parent.mkdir(parents=True, exist_ok=True)
        temporary = file.with_suffix(f".{os.getpid()}")
        temporary.write_text(dumps(record) + "\n", encoding="utf-8")
        temporary.replace(file)

    def _file(self, part: Part, key: str) -> Path:
        return self._folder / f"{part.name.replace(':', '-')}-{key}.json"


def map_code_hash(*more: str) -> str:
    """Return the sha256 of all that a map and its figures depend on, weights among it, and of more files or folders."""
    return hash_of_files((*_CODE, *more), _KINDS)
