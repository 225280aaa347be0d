"""Every view that a run had of its objects, kept by a sink: what all strategies of choosing one can choose from."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hickory_stream.engine.effects import crop_of
from hickory_stream.map_folder.views import write_crop
from hickory_stream.mapping.entities.views import view_of

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from hickory_stream.config import RunConfig
    from hickory_stream.records import FrameReport, MapSnapshot, View


class EveryView:
    """A sink that writes the pixels of all observations that went to an object into a folder, as `views/` has them.

    `config` is that of the run, whose own views are made by it. The sink must miss no report.
    """

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
                observation,
                track_id,
                frame_index=report.index,
                stamp_ns=report.stamp_ns,
                world_from_camera=report.world_from_camera,
            )
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
