"""Verification of a map from its files, journal and meshes.

The digest detects accidents and edits by hand, but is no signature. So the journal is replayed, and layer 4 of each
object is proven from its mesh and its job's points. Checks that lack a journal or an end are reported as unknown.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hickory_stream.errors import MapFolderError
from hickory_stream.events import RequestShape
from hickory_stream.geometry.rigid import apply, invert
from hickory_stream.journal.format import JOURNAL
from hickory_stream.journal.reader import Journal
from hickory_stream.map_folder.digest import map_digest
from hickory_stream.map_folder.history.core_replay import Replay, mesh_names
from hickory_stream.map_folder.history.recorded_config import recorded_config
from hickory_stream.map_folder.history.replay import replay
from hickory_stream.map_folder.manifest import read_manifest
from hickory_stream.map_folder.saved_map import SavedMap, open_map
from hickory_stream.map_folder.views import read_crop
from hickory_stream.map_folder.writer import rewrite_objects
from hickory_stream.mapping.entities.rigid_motion import moved_shape
from hickory_stream.records import ObjectShape, TrackedObject
from hickory_stream.shapes.certify import Certificate, certified_again

# Layer 1 goes on growing after layer 4 was made, but not by this share.
_MOST_OUTSIDE = 0.5


class State(StrEnum):
    """The result of a check."""

    HOLDS = "holds"
    FAILS = "fails"
    UNKNOWN = "unknown"


@dataclass(frozen=True, kw_only=True, slots=True)
class Finding:
    """The result of one check: "digest", "journal", "views", or "layer 4" of an object."""

    check: str
    state: State
    text: str
    object_id: int | None = None


@dataclass(frozen=True, kw_only=True, slots=True)
class Verdict:
    """All findings on a map: of the whole map first, then by object."""

    digest: str
    recorded_digest: str | None
    num_objects: int
    findings: tuple[Finding, ...]

    @property
    def is_sound(self) -> bool:
        """Whether no check failed."""
        return all(finding.state is not State.FAILS for finding in self.findings)

    @property
    def num_proven(self) -> int:
        """Number of objects with a proven layer 4."""
        return sum(finding.check == "layer 4" and finding.state is State.HOLDS for finding in self.findings)


def verify(path: Path, progress: Callable[[str], None] = lambda _: None) -> Verdict:
    """Return the verdict on the map in a folder; nothing is written.

    Raises `MapFolderError`: there is no readable map.
    """
    saved = open_map(path, warns=False, is_whole=True)
    progress("journal")
    points: dict[int, NDArray[np.float32]] = {}
    journal = _journal(saved, points)
    configured_m = _configured_margin_m(saved) if (path / JOURNAL).exists() else None
    objects = []
    for tracked in saved.snapshot.objects:
        progress(f"object {tracked.id}")
        objects += [*_views(saved, tracked), *_layer_four(saved, tracked, points, configured_m)]
    return Verdict(
        digest=saved.digest,
        recorded_digest=saved.manifest.digest,
        num_objects=len(saved.snapshot.objects),
        findings=(_digest(saved), journal, *objects),
    )


def mend(path: Path) -> str:
    """Rewrite the objects of a map from its journal if that gives the manifest's digest; return the digest.

    Raises `MapFolderError`: the journal is damaged, or gives another map, or the disk refused; nothing was changed.
    """
    manifest = read_manifest(path)
    snapshot = replay(path)
    if map_digest(snapshot) != manifest.digest:
        raise MapFolderError(f"{path} cannot be mended: its {JOURNAL} makes another map than that of its manifest")
    with Journal(path) as journal:
        kept = mesh_names(journal)
    return rewrite_objects(path, snapshot, kept)


def _digest(saved: SavedMap) -> Finding:
    if saved.is_altered:
        return Finding(check="digest", state=State.FAILS, text=saved.doubt)
    if saved.doubt:
        return Finding(check="digest", state=State.UNKNOWN, text=saved.doubt)
    text = f"the objects are those that were saved: {saved.digest[:16]}"
    return Finding(check="digest", state=State.HOLDS, text=text)


def _journal(saved: SavedMap, points: dict[int, NDArray[np.float32]]) -> Finding:
    if not (saved.folder / JOURNAL).exists():
        merged = saved.manifest.source.get("kind") == "merge"
        text = "a merged map has none" if merged else f"there is no {JOURNAL}: how the map came about is not known"
        return Finding(check="journal", state=State.UNKNOWN if merged else State.FAILS, text=text)
    tickets = {tracked.shape.revision for tracked in saved.snapshot.objects if tracked.shape is not None}

    def note(request: RequestShape) -> None:
        if request.ticket in tickets:
            points[request.ticket] = request.points_world

    wanted = saved.snapshot.revision
    digests: set[str] = set()
    try:
        config = recorded_config(saved.folder)
        with Journal(saved.folder) as journal:
            again = Replay(journal, config.mapping, note)
            for _ in again.steps(len(journal)):
                # A killed run's folder has the map of an earlier step.
                if not saved.manifest.finished_cleanly and (now := again.snapshot()).revision == wanted:
                    digests.add(map_digest(now))
            last = again.snapshot()
    except MapFolderError as error:
        return Finding(check="journal", state=State.FAILS, text=str(error))
    if map_digest(last) == saved.digest or saved.digest in digests:
        return Finding(check="journal", state=State.HOLDS, text=f"{again.num_steps} steps make the same map")
    if last.revision < wanted and not saved.manifest.finished_cleanly:
        text = f"it ends at revision {last.revision}, before the {wanted} of what was saved"
        return Finding(check="journal", state=State.UNKNOWN, text=text)
    return Finding(check="journal", state=State.FAILS, text=f"its {again.num_steps} steps make another map")


def _views(saved: SavedMap, tracked: TrackedObject) -> Iterator[Finding]:
    for view in tracked.views:
        try:
            read_crop(saved.views, view.name)
        except MapFolderError as error:
            yield Finding(check="views", state=State.FAILS, text=str(error), object_id=tracked.id)


def _layer_four(
    saved: SavedMap, tracked: TrackedObject, points: dict[int, NDArray[np.float32]], configured_m: float | None
) -> Iterator[Finding]:
    shape = tracked.shape
    if shape is None:
        return

    def found(state: State, text: str) -> Finding:
        return Finding(check="layer 4", state=state, text=text, object_id=tracked.id)

    given = points.get(shape.revision)
    try:
        mesh = saved.mesh(shape)
        certificates: list[Certificate] = []
        for placed, around in _where_it_was_made(saved, tracked, shape, given):
            certificates.append(certified_again(placed, mesh, around))
            if not _num_uncovered(certificates[-1]):
                break  # a proof in one world is one
    except (MapFolderError, ValueError) as error:
        yield found(State.FAILS, str(error))
        return
    best = min(certificates, key=_num_uncovered)
    margin_m = shape.containment.margin_m
    if configured_m is not None and margin_m < configured_m:
        yield found(State.FAILS, f"its margin is {margin_m:g} m, the map was made with {configured_m:g} m")
    elif not shape.containment.is_certified:
        yield found(State.UNKNOWN, "it was not certified when it was made")
    elif best.uncovered_triangles or best.uncovered_cells or (given is not None and best.uncovered_points):
        text = f"{best.uncovered_triangles} triangles, {best.uncovered_cells} cells of the inside"
        yield found(State.FAILS, f"{text} and {best.uncovered_points} points lie outside of it")
    elif best.uncovered_points > _MOST_OUTSIDE * max(best.num_points, 1):
        yield found(State.FAILS, f"{best.uncovered_points} of {best.num_points} points of layer 1 lie outside of it")
    else:
        later = f"; {best.uncovered_points} later points lie outside" if best.uncovered_points else ""
        yield found(State.HOLDS, f"proven anew with a margin of {margin_m:g} m{later}")


def _num_uncovered(certificate: Certificate) -> int:
    return certificate.uncovered_triangles + certificate.uncovered_cells + certificate.uncovered_points


def _where_it_was_made(
    saved: SavedMap, tracked: TrackedObject, shape: ObjectShape, given: NDArray[np.float32] | None
) -> list[tuple[ObjectShape, NDArray[np.float32]]]:
    # The cells of the inside stand along the axes of the world where the shape was made. Of a map that was moved since,
    # that may be the submap's own: a proof in either world counts.
    poses = {submap.id: submap.world_from_submap for submap in saved.snapshot.submaps}
    submap_from_world = invert(poses.get(tracked.submap_id, np.eye(4)))
    unmoved = moved_shape(shape, submap_from_world)
    if given is not None:
        return [(unmoved, given)]
    return [(shape, tracked.points_world), (unmoved, np.asarray(apply(submap_from_world, tracked.points_world)))]


def _configured_margin_m(saved: SavedMap) -> float | None:
    # None where the configuration is unknown.
    try:
        return recorded_config(saved.folder).shapes.inflate.r_safe_m
    except MapFolderError:
        return None
