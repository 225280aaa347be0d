"""The paper's experiment on views: each object reconstructed from the one view that each strategy would choose."""
# A log is played once. The strategies change which view is the best, not the tracks, so that all of them choose among
# the views of the same objects, which a sink keeps, and an object's rows differ by the chosen view alone.

import tempfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import get_args

import numpy as np
from numpy.typing import NDArray

from hickory_stream.config import MapperConfig, RunConfig
from hickory_stream.engine.effects import crop_of
from hickory_stream.engine.mapper import Mapper
from hickory_stream.engine.play import play
from hickory_stream.evaluation.evaluate import true_surface
from hickory_stream.evaluation.match import TruthScore, meshes_of, score_map
from hickory_stream.evaluation.placement import placed_truth
from hickory_stream.evaluation.surface_score import SurfaceScore, TrueSurface, diameter_m, surface_score
from hickory_stream.evaluation.truth import Truth, moved_mesh
from hickory_stream.geometry.rigid import compose, invert
from hickory_stream.inspection.supports import supports_of
from hickory_stream.map_folder.saved_map import open_map
from hickory_stream.map_folder.views import read_crop, write_crop
from hickory_stream.mapping.config import MappingConfig
from hickory_stream.mapping.entities.rigid_motion import moved_object
from hickory_stream.mapping.entities.views import Strategy, ViewConfig, score, view_of
from hickory_stream.mapping.rules.support_graph import Relation
from hickory_stream.ports import NoShape, Reconstructor, ShapeInputs, Source
from hickory_stream.records import FrameReport, MapSnapshot, TrackedObject, View
from hickory_stream.shapes.build import make_reconstructor
from hickory_stream.shapes.mesh_validation import usable
from hickory_stream.sinks.disk_sink import DiskSink


class EveryView:
    """A sink that writes the pixels of all observations that went to an object into a folder, as `views/` has them."""

    # `config` is that of the run, whose own views are made by it. The sink must miss no report.
    def __init__(self, folder: Path, config: RunConfig) -> None:
        self.folder = folder
        self._config = config
        self._by_track: dict[int, list[View]] = {}
        folder.mkdir(parents=True, exist_ok=True)

    def show(self, report: FrameReport) -> None:
        """Keep what a keyframe saw of the tracks."""
        if report.frame is None:
            return
        for track_id, observation in zip(report.object_ids, report.observations, strict=True):
            if track_id is None:
                continue
            view = view_of(
                observation, track_id, frame_index=report.index, stamp_ns=report.stamp_ns,
                world_from_camera=report.world_from_camera,
            )  # fmt: skip
            crop = crop_of(report.frame, observation, self._config.crop_margin)
            write_crop(self.folder, view.name, crop, self._config)
            self._by_track.setdefault(track_id, []).append(view)

    def close(self) -> None:
        """Nothing is left to be done."""

    def of_objects(self, snapshot: MapSnapshot) -> dict[int, list[View]]:
        """Return all views of each object of a map, those of the tracks that became it included; sorted by frame."""
        return {
            item.id: sorted(
                (view for track_id in (item.id, *item.merged_ids) for view in self._by_track.get(track_id, ())),
                key=lambda view: view.name,
            )
            for item in snapshot.objects
        }


def largest_of_frames(views: Iterable[View]) -> list[View]:
    """Return one view of each frame, the largest: others of an object are of its parts."""
    largest: dict[int, View] = {}
    for view in views:
        before = largest.get(view.frame_index)
        if before is None or view.r_area > before.r_area:
            largest[view.frame_index] = view
    return list(largest.values())


OURS: Strategy = "s_score"
STRATEGIES: tuple[Strategy, ...] = get_args(Strategy)


@dataclass(frozen=True, kw_only=True, slots=True)
class ViewTrial:
    """A true object that counts, and the score of each strategy's view: None without a shape, {} if missed."""

    diameter_m: float
    scores: Mapping[str, SurfaceScore | None]


def try_views(source: Source, truth: Truth, config: MapperConfig, out: Path) -> tuple[ViewTrial, ...]:
    """Play a log into the map folder `out`, and reconstruct each object from one view, by `single_view`."""
    # Raises HickoryError: the log, the map folder or the truth cannot be used.
    mapping = replace(
        config.mapping,
        views=replace(config.mapping.views, strategy=OURS),
        requests=replace(config.mapping.requests, max_failures=0),
    )
    config = replace(config, mapping=mapping)
    reconstructor = make_reconstructor("single_view", config.shapes)
    with tempfile.TemporaryDirectory(prefix="hickory-views-") as temporary:
        views = EveryView(Path(temporary), config.run)
        mapper = Mapper(config, out=out, overwrite=True)
        play(mapper, source, sinks=lambda folder: [(DiskSink(folder), True), (views, True)], progress=lambda _: None)
        saved = open_map(out)
        truth = placed_truth(saved, truth).truth
        rows = [row for row in score_map(saved.snapshot, meshes_of(saved), truth).truth if row.counts]
        seen = _seen_objects(saved.snapshot, views, config.mapping)
        items = {item.id: item for item in truth.objects}
        return tuple(
            _trial(row, seen, true_surface(truth, items[row.truth_id]), reconstructor, views.folder) for row in rows
        )


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Seen:
    item: TrackedObject
    views: Sequence[View]
    support_z_m: float | None
    world_from_submap: NDArray[np.float64]


def _seen_objects(snapshot: MapSnapshot, views: EveryView, config: MappingConfig) -> dict[int, _Seen]:
    placed = {submap.id: submap.world_from_submap for submap in snapshot.submaps}
    supports, by_object = supports_of(snapshot, config), views.of_objects(snapshot)
    return {
        item.id: _Seen(
            item=moved_object(item, invert(placed[item.submap_id])),
            views=by_object[item.id],
            support_z_m=next((e.height_m for e in supports[item.id] if e.relation is Relation.RESTS_ON), None),
            world_from_submap=placed[item.submap_id],
        )
        for item in snapshot.objects
    }


def chosen_views(item: TrackedObject, seen: Sequence[View]) -> dict[str, View]:
    """Return the view of an object that each strategy chooses of those `seen`; S's is the one that the map chose."""
    chosen: dict[str, View] = {}
    for strategy in STRATEGIES:
        if strategy == OURS:
            if item.best_view is not None:
                chosen[strategy] = item.best_view
        elif seen:
            config = ViewConfig(strategy=strategy)
            chosen[strategy] = max(
                largest_of_frames(seen), key=lambda view: (score(view, 0.0, config), -view.frame_index)
            )
    return chosen


def _trial(
    row: TruthScore, seen: Mapping[int, _Seen], true: TrueSurface, reconstructor: Reconstructor, folder: Path
) -> ViewTrial:
    scores: dict[str, SurfaceScore | None] = {}
    if row.map_id is not None:
        of = seen[row.map_id]
        chosen = {strategy: view.name for strategy, view in chosen_views(of.item, of.views).items()}
        kept = {view.name for view in of.views}
        made = {
            name: _score(of, name, true, reconstructor, folder, seed=row.truth_id)
            for name in sorted(kept.intersection(chosen.values()))
        }
        scores = {strategy: made.get(name) for strategy, name in chosen.items()}
    return ViewTrial(diameter_m=diameter_m(true.mesh.vertices), scores=scores)


def _score(
    of: _Seen, name: str, true: TrueSurface, reconstructor: Reconstructor, folder: Path, seed: int
) -> SurfaceScore | None:
    inputs = ShapeInputs(
        crops=(read_crop(folder, name),), points_world=of.item.points_world, colors=of.item.colors, box=of.item.box,
        support_z_m=of.support_z_m,
    )  # fmt: skip
    found = reconstructor.reconstruct(inputs)
    if isinstance(found, NoShape):
        return None
    try:
        mesh = usable(found.mesh)
    except ValueError:
        return None
    world_from_object = compose(of.world_from_submap, found.world_from_object)
    return surface_score(true, moved_mesh(mesh, world_from_object), np.random.default_rng(seed))
