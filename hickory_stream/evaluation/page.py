"""HTML page of an evaluation: every true object beside its match, worst first, in one file."""

import html
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.atomic_files import write_output
from hickory_stream.base.html_page import page, picture
from hickory_stream.evaluation.evaluate import Evaluation, ObjectEvaluation, placed_mesh, true_mesh_world
from hickory_stream.evaluation.explain import figures, verdict, worst_first
from hickory_stream.evaluation.false_origins import FALSE_ORIGINS, FalseObject
from hickory_stream.evaluation.match import meshes_of
from hickory_stream.evaluation.miss_reasons import MISS_REASONS, Missed
from hickory_stream.evaluation.truth import Truth, frame_at, instances_of, moved_truth
from hickory_stream.evaluation.why import NoWhy, ReasonCount, Why, reasons_of
from hickory_stream.evaluation.why_text import false_title, missed_title
from hickory_stream.geometry.mesh import Mesh
from hickory_stream.journal.reader import Journal
from hickory_stream.journal.step import Step, StepKind
from hickory_stream.map_folder.saved_map import SavedMap
from hickory_stream.map_folder.views import read_crop
from hickory_stream.pictures.legend import GENERATED, GENERATED_TEXT, with_tint
from hickory_stream.pictures.object_thumbnail import CloseUp, close_up_of, draw
from hickory_stream.pictures.raycast import Surface
from hickory_stream.pictures.render_parts import superquadric_surfaces
from hickory_stream.records import TrackedObject

_PICTURE_PX = 400
_STYLE = """
h3 { font-size: 1rem; margin: 0 0 .4rem; } table + h3 { margin-top: 1.2rem; }
figcaption { color: var(--soft); }
p.why { margin: .4rem 0 0; max-width: 125ch; }
.top { display: flex; gap: 1rem 2.5rem; flex-wrap: wrap; align-items: flex-start; }
.top > div { flex: 1 1 34rem; }
.reasons td { vertical-align: baseline; padding-right: .8rem; } .reasons td.soft { font-size: .88rem; }
.reasons td.n, .reasons td:nth-child(3) { white-space: nowrap; } .reasons td:nth-child(3) { min-width: 11.5rem; }
.reasons td.n { min-width: 3.5rem; }
td.bar { min-width: 5rem; } td.bar i { display: block; height: .6rem; border-radius: 3px; background: var(--bad); }
.key { display: inline-block; width: .8rem; height: .8rem; }
td { padding: .12rem 1.2rem .12rem 0; }
section { background: var(--card); border: 1px solid var(--line); border-radius: 8px; padding: .8rem 1rem;
  margin: .7rem 0; }
section header { display: flex; gap: 1rem; align-items: baseline; flex-wrap: wrap; }
section header b { font-size: 1.05rem; }
.bad { border-left: 5px solid var(--bad); } .fair { border-left: 5px solid var(--fair); }
.good { border-left: 5px solid var(--good); }
.row { display: flex; gap: .7rem; flex-wrap: wrap; margin-top: .6rem; }
figure { margin: 0; } figure img { width: 172px; height: 172px; object-fit: contain; border-radius: 6px;
  background: #eceef2; display: block; } figcaption { font-size: .82rem; text-align: center; }
"""


def write_page(path: Path, saved: SavedMap, truth: Truth, evaluation: Evaluation) -> None:
    """Write the page; raises `MapFolderError` or `RecordingError` for a file that cannot be read or written."""
    by_id = {tracked.id: tracked for tracked in saved.snapshot.objects}
    meshes = meshes_of(saved)
    why = reasons_of(saved, truth)
    if evaluation.placement is not None:
        truth = moved_truth(truth, np.array(evaluation.placement.map_from_world))
    true = {item.id: true_mesh_world(truth, item) for item in truth.objects}
    missed = {item.truth_id: item for item in why.missed} if isinstance(why, Why) else {}
    ranked = worst_first(evaluation)
    frames = {i: item.best_frame for i, item in missed.items() if item.best_frame is not None}
    in_the_log = pictures_of(saved.folder, truth, frames) if frames else {}
    cards = [
        _card(row, saved, by_id, meshes, true[row.truth_id], missed.get(row.truth_id), in_the_log.get(row.truth_id))
        for row in ranked
    ]
    origins = {item.map_id: item for item in why.false} if isinstance(why, Why) else {}
    false_ids = sorted(origins) if isinstance(why, Why) else evaluation.stray_ids
    false = [_false(by_id[i], saved, meshes, origins.get(i)) for i in false_ids]
    table = "".join(
        f"<tr><td class=soft>{html.escape(name)}</td><td class=n>{html.escape(text)}</td></tr>"
        for name, text in figures(evaluation)
    )
    body = (
        f"<h1>{html.escape(saved.folder.name)} against {html.escape(truth.folder.name)}</h1>"
        "<p class=soft>What figures and reasons mean: <code>hickory-stream evaluate --explain</code>; one object "
        "keyframe by keyframe: <code>hickory-stream explain MAP --truth DIR --object ID</code></p>"
        f"<div class=top><table>{table}</table>{_reasons(why)}</div>"
        f"<p class=soft><i class=key style='background:rgb{GENERATED}'></i> {GENERATED_TEXT}</p>"
        f"<h2>True objects, worst first</h2>{''.join(cards)}"
    )
    if false:
        body += f"<h2>{'False objects' if isinstance(why, Why) else 'Objects on no true object'}</h2>{''.join(false)}"
    write_output(path, page(f"{saved.folder.name}: evaluation", body, _STYLE).encode())


def _reasons(why: Why | NoWhy) -> str:
    if isinstance(why, NoWhy):
        return f"<div><p class=soft>No reasons for missed objects: {html.escape(why.reason)}</p></div>"
    return (
        f"<div>{_counted(missed_title(why), why.reasons, len(why.missed), MISS_REASONS)}"
        f"{_counted(false_title(why), why.origins, len(why.false), FALSE_ORIGINS)}</div>"
    )


def _counted(title: str, counts: Sequence[ReasonCount], total: int, meanings: Mapping[Any, str]) -> str:
    rows = "".join(
        f"<tr><td class=n>{item.count} of {total}</td>"
        f"<td class=bar><i style='width:{100 * item.count / total:.0f}%'></i></td>"
        f"<td>{html.escape(item.reason)}</td><td class=soft>{html.escape(meanings[item.reason])}</td></tr>"
        for item in counts
    )
    return f"<h3>{html.escape(title)}</h3>" + (f"<table class=reasons>{rows}</table>" if rows else "")


def _card(
    row: ObjectEvaluation,
    saved: SavedMap,
    by_id: Mapping[int, TrackedObject],
    meshes: Mapping[int, Mesh],
    true: Mesh,
    missed: Missed | None,
    in_the_log: NDArray[np.uint8] | None,
) -> str:
    tracked = by_id[row.map_id] if row.map_id is not None else None
    pieces = [by_id[i] for i in row.track_ids if i != row.map_id]
    shown = tracked if tracked is not None else (pieces[0] if pieces else None)
    view = close_up_of(true.vertices, _azimuth(shown, true))
    pictures = [_figure("true mesh", draw([_surface(true)], view))]
    if shown is not None:
        pictures = [*_view_figure(shown, saved), *pictures, *_layers(shown, meshes, view)]
    if missed is not None and in_the_log is not None:
        pictures = [_figure(f"frame {missed.best_frame}", in_the_log), *pictures]
    state = "good" if row.f1_5pct >= 0.9 else "fair" if row.f1_5pct >= 0.7 else "bad"
    numbers = [f"seen {row.seen_fraction:.0%}", f"d {row.diameter_m:.2f} m"]
    if row.map_id is not None:
        numbers += [f"object #{row.map_id}", f"IoU {row.iou:.2f}", f"F1 {row.f1_5pct:.2f}"]
    if row.add_s_m is not None:
        numbers.append(f"ADD-S {row.add_s_m / row.diameter_m:.3f} d")
    if row.contained is not None:
        numbers.append(f"contained {row.contained:.2%}")
    said = verdict(row) if missed is None else f"missed: {missed.reason}"
    return (
        f"<section class={state}><header><b>{row.truth_id} {html.escape(row.kind)}</b><span>{said}</span>"
        f"<span class=soft>{' · '.join(numbers)}</span></header>{_why('' if missed is None else missed.text)}"
        f"<div class=row>{''.join(pictures)}</div></section>"
    )


def _why(text: str) -> str:
    return f"<p class=why>{html.escape(text)}</p>" if text else ""


def _false(tracked: TrackedObject, saved: SavedMap, meshes: Mapping[int, Mesh], origin: FalseObject | None) -> str:
    mesh = placed_mesh(tracked, meshes)
    vertices = mesh.vertices if mesh is not None else tracked.points_world
    view = close_up_of(vertices, _azimuth(tracked, None))
    pictures = [*_view_figure(tracked, saved), *_layers(tracked, meshes, view)]
    size = " x ".join(f"{side:.2f}" for side in 2 * tracked.box.half_extents_m)
    return (
        f"<section class=bad><header><b>object #{tracked.id}</b>"
        f"<span>{'on no true object' if origin is None else origin.origin}</span>"
        f"<span class=soft>{size} m · seen in {tracked.sightings} keyframes</span></header>"
        f"{_why('' if origin is None else origin.text)}<div class=row>{''.join(pictures)}</div></section>"
    )


def _layers(tracked: TrackedObject, meshes: Mapping[int, Mesh], view: CloseUp) -> list[str]:
    mesh = placed_mesh(tracked, meshes)
    if mesh is None or tracked.shape is None:
        return []
    drawn = [("2: mesh", [_surface(mesh)])]
    drawn.append(("3: superquadrics", superquadric_surfaces(tracked.shape.fitted, tracked.id)))
    drawn.append(("4: inflated", superquadric_surfaces(tracked.shape.inflated, tracked.id)))
    return [_figure(name, draw(surfaces, view)) for name, surfaces in drawn]


def _view_figure(tracked: TrackedObject, saved: SavedMap) -> list[str]:
    best = tracked.best_view or (tracked.views[0] if tracked.views else None)
    if best is None:
        return []
    crop = read_crop(saved.views, best.name)
    dimmed = np.where(crop.mask[..., None], crop.rgb, 0.35 * crop.rgb + 0.65 * 200).astype(np.uint8)
    return [_figure("best view", dimmed)]


def _azimuth(tracked: TrackedObject | None, true: Mesh | None) -> float:
    if tracked is None or tracked.best_view is None:
        return 0.6
    center = tracked.box.center if true is None else true.vertices.mean(axis=0)
    offset = tracked.best_view.world_from_camera[:2, 3] - center[:2]
    return float(np.arctan2(offset[1], offset[0]))


def _surface(mesh: Mesh) -> Surface:
    colors = with_tint(mesh.colors, mesh.is_seen)
    return Surface(vertices=mesh.vertices, faces=mesh.faces, colors=colors, owner=0)


def _figure(caption: str, rgb: NDArray[np.uint8]) -> str:
    return f"<figure>{picture(rgb, caption, _PICTURE_PX)}<figcaption>{caption}</figcaption></figure>"


# Pictures of true objects, cut out of the keyframe images in a map's journal.
_MARGIN = 0.6
_LEAST_MARGIN_PX = 12


def pictures_of(path: Path, truth: Truth, frames: Mapping[int, int]) -> dict[int, NDArray[np.uint8]]:
    """Return a picture (h, w, 3) of each true object, dimmed outside the object, from the keyframe in `frames`.

    Objects whose keyframe has no image in the journal, or does not show them, are left out. Raises `MapFolderError` for
    the journal, `RecordingError` for an image of the truth.
    """
    stamps = np.array([frame.stamp_ns for frame in truth.frames], dtype=np.int64)
    pictures: dict[int, NDArray[np.uint8]] = {}
    with Journal(path) as journal:
        steps = {step.frames[-1].index: i for i, step in _keyframe_steps(journal)}
        for truth_id, frame in frames.items():
            index = steps.get(frame)
            color = journal.color(index) if index is not None else None
            at = frame_at(stamps, int(journal.stamps_ns[index])) if index is not None else None
            if color is None or at is None:
                continue
            image = cv2.imdecode(np.frombuffer(color, np.uint8), cv2.IMREAD_COLOR)
            mask = instances_of(truth, truth.frames[at]) == truth_id
            if image is not None and image.shape[:2] == mask.shape and mask.any():
                pictures[truth_id] = _cut_out(np.asarray(image[..., ::-1], dtype=np.uint8), mask)
    return pictures


def _keyframe_steps(journal: Journal) -> list[tuple[int, Step]]:
    steps = ((i, journal.step(i)) for i in range(len(journal)))
    return [(i, step) for i, step in steps if step.kind is StepKind.KEYFRAME and step.frames]


def _cut_out(rgb: NDArray[np.uint8], mask: NDArray[np.bool_]) -> NDArray[np.uint8]:
    rows, columns = np.nonzero(mask)
    height, width = mask.shape
    half = int(max(np.ptp(rows), np.ptp(columns)) / 2 * (1 + _MARGIN)) + _LEAST_MARGIN_PX
    row, column = int(rows.min() + rows.max()) // 2, int(columns.min() + columns.max()) // 2
    window = slice(max(0, row - half), min(height, row + half)), slice(max(0, column - half), min(width, column + half))
    part, inside = rgb[window], mask[window]
    dimmed = np.where(inside[..., None], part, 0.5 * part + 0.5 * 200).astype(np.uint8)
    scale = max(1, 200 // max(part.shape[:2]))
    size = (part.shape[1] * scale, part.shape[0] * scale)
    return np.asarray(cv2.resize(dimmed, size, interpolation=cv2.INTER_NEAREST), dtype=np.uint8)
