"""A shape job as a folder of files, and the reasons of failed jobs.

    jobs/TICKET/
      job.json       reconstructor, configuration, box, support height, the names of the views, best first
      points.npy     layer 1: (N, 3) float32;  colors.npy  (N, 3) uint8
      NAME.*         the pixels of the views: hard links, so that a view may be dropped while the job runs
      shape.mesh     the answer: layer 2, in the object frame (`mesh_file`)
      result.json    the answer: its place, layers 3 and 4, timings; or the reason why there is none

Files rather than a pipe: a worker may be another interpreter, and a bad input can be examined afterwards.
"""

import dataclasses
import json
import shutil
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hickory_stream.base.atomic_files import disk_errors, link_or_copy, outside_errors, write_atomically
from hickory_stream.base.config_text import from_dict
from hickory_stream.base.confined import path_within, plain_name, read_within
from hickory_stream.base.former_keys import with_current_names
from hickory_stream.base.json_text import dumps, dumps_exactly
from hickory_stream.errors import HickoryError, WorkerError
from hickory_stream.events import RequestShape
from hickory_stream.geometry.boxes import OrientedBox
from hickory_stream.geometry.codecs.mesh_file import SUFFIX, mesh_file_bytes, mesh_of_file
from hickory_stream.geometry.mesh import sha256_of
from hickory_stream.map_folder.array_files import npy_array
from hickory_stream.map_folder.codec import decode_superquadrics, encode_superquadrics
from hickory_stream.map_folder.views import crop_files, read_crop
from hickory_stream.ports import BuiltShape, NoShape, ShapeInputs
from hickory_stream.records import Containment, ObjectShape
from hickory_stream.shapes.build import ShapeConfig

MESH, RESULT, JOB = f"shape{SUFFIX}", "result.json", "job.json"
FAILED, FAILURE = "failed", "failure.json"


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ShapeAnswer:
    """The result of a job: a shape, or the reason for none."""

    shape: ObjectShape | None
    reason: str
    #: By step, seconds.
    timings_s: Mapping[str, float]
    #: A step was given up at a limit, so that a repetition may differ.
    hit_limit: bool = False


def job_folder(jobs: Path, ticket: int) -> Path:
    """Return the folder of a job."""
    return jobs / f"{ticket:06d}"


def write_job(folder: Path, request: RequestShape, views: Path, config: ShapeConfig) -> None:
    """Write a job; `job.json` comes last, as the mark of a complete input.

    Raises `MapFolderError`: the disk refused, or a view is a link that leads out of the map.
    """
    job = {
        "views": [view.name for view in request.views],
        "config": dataclasses.asdict(config),
        "world_from_box": request.box.world_from_box.tolist(),
        "half_extents_m": request.box.half_extents_m.tolist(),
        "support_z_m": request.support_z_m,
    }
    with outside_errors():
        sources = [path_within(views, file.name) for view in request.views for file in crop_files(views, view.name)]
    with disk_errors(folder):
        # What a run left here that was killed and is continued.
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        for source in sources:
            link_or_copy(source, folder / source.name)
        np.save(folder / "points.npy", request.points_world, allow_pickle=False)
        np.save(folder / "colors.npy", request.colors, allow_pickle=False)
        (folder / JOB).write_text(dumps_exactly(job))


def read_job(folder: Path) -> tuple[ShapeInputs, ShapeConfig]:
    """Return the content of a job.

    Raises OSError, ValueError, KeyError, TypeError, RecursionError or `HickoryError`: it is damaged or missing.
    """
    job = json.loads(read_within(folder, JOB))
    inputs = ShapeInputs(
        crops=tuple(read_crop(folder, plain_name(name)) for name in job["views"]),
        points_world=npy_array(read_within(folder, "points.npy"), "<f4"),
        colors=npy_array(read_within(folder, "colors.npy"), "|u1"),
        box=OrientedBox(world_from_box=job["world_from_box"], half_extents_m=job["half_extents_m"]),
        support_z_m=job["support_z_m"],
    )
    return inputs, from_dict(ShapeConfig, with_current_names(job["config"], "shapes."), "shapes.")


def write_result(folder: Path, built: BuiltShape | NoShape, reconstructor: str) -> None:
    """Write an answer; `result.json` comes last and whole."""
    if isinstance(built, NoShape):
        result: dict[str, Any] = {"reason": built.reason, "hit_limit": built.hit_limit}
    else:
        write_atomically(folder / MESH, mesh_file_bytes(built.reconstruction.mesh), sync=False)
        result = {
            "reconstructor": built.reconstruction.made_by or reconstructor,
            "verdict": built.reconstruction.verdict,
            "hit_limit": built.reconstruction.hit_limit,
            "world_from_object": built.reconstruction.world_from_object.tolist(),
            "fitted": encode_superquadrics(built.fitted),
            "inflated": encode_superquadrics(built.inflated),
            "seen_share": built.seen_share.tolist(),
            "containment": dataclasses.asdict(built.containment),
            "fit_kind": built.fit_kind,
            "timings_s": dict(built.timings_s),
        }
    write_atomically(folder / RESULT, dumps_exactly(result).encode(), sync=False)


def take_result(folder: Path, ticket: int, object_id: int, shapes: Path) -> ShapeAnswer:
    """Return the answer of a job, and move its mesh into the map's `shapes/`; the job stays until it is removed.

    Raises `WorkerError`: there is no readable answer.
    """
    try:
        result = json.loads(read_within(folder, RESULT))
        if "reason" in result:
            return ShapeAnswer(
                shape=None, reason=result["reason"], timings_s={}, hit_limit=bool(result.get("hit_limit"))
            )
        # The hash is of what the worker wrote, read back: the map's digest then holds for the file.
        content = read_within(folder, MESH)
        mesh = mesh_of_file(content)
        name = f"{object_id:06d}-{ticket:06d}{SUFFIX}"
        write_atomically(shapes / name, content, sync=False)
        shape = ObjectShape(
            revision=ticket,
            reconstructor=result["reconstructor"],
            mesh_name=name,
            mesh_sha256=sha256_of(mesh),
            world_from_object=result["world_from_object"],
            fitted=decode_superquadrics(result["fitted"]),
            inflated=decode_superquadrics(result["inflated"]),
            seen_share=result["seen_share"],
            containment=Containment(**result["containment"]),
            verdict=str(result.get("verdict", "")),
            fit_kind=result.get("fit_kind", "solid"),
        )
    except (OSError, ValueError, KeyError, TypeError, IndexError, AttributeError, RecursionError) as error:
        raise WorkerError(f"job {ticket}: no readable answer in {folder}: {error}") from error
    return ShapeAnswer(shape=shape, reason="", timings_s=result["timings_s"], hit_limit=bool(result.get("hit_limit")))


def keep_input(folder: Path, failed: Path, object_id: int, reason: str) -> None:
    """Move the input of a failed job, with the reason, to `failed`; the latest of each object is kept."""
    kept = failed / f"{object_id:06d}"
    shutil.rmtree(kept, ignore_errors=True)
    try:
        folder.replace(kept)
        write_atomically(kept / FAILURE, dumps({"reason": reason}).encode(), sync=False)
    except OSError:
        shutil.rmtree(folder, ignore_errors=True)


_UNKNOWN = "no reason was kept"


@dataclass(frozen=True, kw_only=True, slots=True)
class FailedShapes:
    """Objects whose latest shape job failed for one reason, and the inputs of these jobs."""

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
