"""A small map of an in-memory scene, with every kind of file of a map folder: the map that is damaged."""

from dataclasses import replace
from pathlib import Path

from hickory_stream.base.config_text import read_config
from hickory_stream.box_scene import SceneSource
from hickory_stream.config import MapperConfig
from hickory_stream.engine.shape_jobs.job_folder import write_job
from hickory_stream.events import RequestShape
from hickory_stream.map_folder.manifest import MANIFEST, manifest_json
from hickory_stream.map_folder.saved_map import open_map
from hickory_stream.testing import InstanceSegmenter, MeanColorExtractor
from tools.benchmarks.common.cached_runs import play_into
from tools.benchmarks.common.processes import COARSE

_NUM_FRAMES = 6
_OVERRIDES = (
    *COARSE, "mapping.requests.first_sightings=2", "mapping.requests.latency_s=0.5", "journal.checkpoint_keyframes=3",
    "run.workers=1",
)  # fmt: skip


def write_small_map(path: Path) -> None:
    """Write a finished map of a few objects, with the input of a shape job in `failed/`."""
    config = read_config(MapperConfig, None, _OVERRIDES)
    segmenter = InstanceSegmenter(SceneSource(_NUM_FRAMES).instances)
    play_into(path, SceneSource(_NUM_FRAMES), config, segmenter=segmenter, extractor=MeanColorExtractor())
    saved = open_map(path)
    tracked = next(item for item in saved.snapshot.objects if item.shape is not None)
    request = RequestShape(
        ticket=1, object_id=tracked.id, views=tracked.views, points_world=tracked.points_world, colors=tracked.colors,
        box=tracked.box, support_z_m=0.0, due_ns=0,
    )  # fmt: skip
    write_job(path / "failed" / f"{tracked.id:06d}", request, saved.views, config.shapes)


def as_live_and_killed(path: Path) -> None:
    """Make a map look like a killed live run, which `resume` saves as of its last step."""
    manifest = open_map(path, warns=False).manifest
    run = {**manifest.run, "mode": "live"}
    killed = replace(manifest, finished_cleanly=False, digest=None, run=run)
    (path / MANIFEST).unlink()
    (path / MANIFEST).write_bytes(manifest_json(killed))
