"""A small map of an in-memory scene, with everything that a map folder can hold: what damage to maps is done to."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from pathlib import Path

from hickory_stream.box_scene import SceneSource
from hickory_stream.config import MapperConfig
from hickory_stream.config_text import read_config
from hickory_stream.engine.jobs import write_job
from hickory_stream.engine.manifest import MANIFEST, manifest_json
from hickory_stream.engine.mapper import Mapper
from hickory_stream.engine.saved_map import open_map
from hickory_stream.events import RequestShape
from hickory_stream.testing import InstanceSegmenter, MeanColorExtractor
from tools.benchmarks.common.coarse_runs import COARSE

_NUM_FRAMES = 6
_OVERRIDES = (
    *(override.removeprefix("mapper.") for override in COARSE),
    "mapping.requests.first_sightings=2",
    "mapping.requests.latency_s=0.5",
    "journal.checkpoint_keyframes=3",
    "run.workers=1",
)


def write_small_map(path: Path) -> None:
    """Write a finished map of a few objects, with the input of a shape job in `failed/`."""
    config = read_config(MapperConfig, None, _OVERRIDES)
    asyncio.run(_map(config, path))
    saved = open_map(path)
    tracked = next(item for item in saved.snapshot.objects if item.shape is not None)
    request = RequestShape(
        ticket=1,
        object_id=tracked.id,
        views=tracked.views,
        points_world=tracked.points_world,
        colors=tracked.colors,
        box=tracked.box,
        support_z_m=0.0,
        due_ns=0,
    )
    write_job(path / "failed" / f"{tracked.id:06d}", request, saved.views, config.shapes)


def as_live_and_killed(path: Path) -> None:
    """Make a map that of a live run that was killed, which `resume` saves as of its last step."""
    manifest = open_map(path, warns=False).manifest
    run = {**manifest.run, "mode": "live"}
    killed = replace(manifest, finished_cleanly=False, digest=None, run=run)
    (path / MANIFEST).unlink()
    (path / MANIFEST).write_bytes(manifest_json(killed))


async def _map(config: MapperConfig, path: Path) -> None:
    segmenter = InstanceSegmenter(SceneSource(_NUM_FRAMES).instances)
    async with Mapper(config, out=path, segmenter=segmenter, extractor=MeanColorExtractor()) as mapper:
        async for _ in mapper.run(SceneSource(_NUM_FRAMES)):
            pass
