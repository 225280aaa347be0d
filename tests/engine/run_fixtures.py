"""Runs over the in-memory scene: what the tests of the engine share."""

import asyncio
from dataclasses import dataclass
import numpy as np
import psutil
from hickory_stream.base.config_text import read_config
from hickory_stream.box_scene import SCENE_BOXES, SceneSource
from hickory_stream.config import MapperConfig, RunConfig
from hickory_stream.engine.effects import crop_of
from hickory_stream.engine.mapper import Mapper
from hickory_stream.events import RequestShape
from hickory_stream.geometry.boxes import gravity_aligned_box
from hickory_stream.geometry.lattice import Lattice
from hickory_stream.map_folder.views import write_crop
from hickory_stream.map_folder.writer import MapFolder
from hickory_stream.perception.perceive import PerceptionConfig, perceive
from hickory_stream.records import MapSnapshot, View
from hickory_stream.testing import InstanceSegmenter, MeanColorExtractor
from tests.conftest import COARSE_SHAPES
from tests.in_process_workers import InProcessWorkers

NUM_FRAMES = 8
SOON = ("mapping.lifecycle.confirm_s=0.5", "mapping.requests.first_sightings=2", "mapping.requests.latency_s=0.5")
# A worker takes two seconds to start, and there are three shapes.
FEW = ("run.workers=1",)
DEFAULT_RUN = RunConfig()
NO_SHAPES = ("mapping.requests.max_failures=0",)


def scene_config(path, *overrides):
    """Return a configuration with coarse shapes that are asked for soon, and built by one worker."""
    path.mkdir(parents=True, exist_ok=True)
    (path / "coarse.toml").write_text(COARSE_SHAPES.replace("[mapper.", "["))
    return read_config(MapperConfig, path / "coarse.toml", (*SOON, *FEW, *overrides))


@dataclass(frozen=True, kw_only=True)
class SceneRun:
    """What a run left."""

    snapshots: list[MapSnapshot]
    folder: MapFolder

    @property
    def digest(self):
        return self.folder.manifest.digest


def map_scene(
    tmp_path,
    *overrides,
    name="map",
    boxes=SCENE_BOXES,
    source=None,
    sinks=None,
    loops=1,
    rate=None,
    mode="playback",
    segmenter=None,
    on_progress=lambda _, __: None,
    on_snapshot=None,
    child_workers=False,
):
    """Map the scene, of all or of some `boxes`, or a source that wraps it, into `tmp_path/name`.

    Shapes are built on a thread, by the workers that the configuration asks for only with `child_workers`.
    """
    scene = SceneSource(NUM_FRAMES, boxes)
    made = []

    async def run():
        async with Mapper(
            scene_config(tmp_path / f"{name}-config", *overrides),
            out=tmp_path / name,
            segmenter=segmenter or InstanceSegmenter(scene.instances),
            extractor=MeanColorExtractor(),
            workers=None if child_workers else InProcessWorkers(),
        ) as mapper:
            snapshots = []
            played = mapper.run(
                source or scene, sinks=sinks, loops=loops, rate=rate, mode=mode,
                progress=lambda progress: on_progress(mapper, progress),
            )  # fmt: skip
            async for snapshot in played:
                snapshots.append(snapshot)
                if on_snapshot is not None:
                    await on_snapshot(mapper, snapshot)
            made.append(SceneRun(snapshots=snapshots, folder=mapper.folder))

    # Not as the task's result: asyncio prints that when it puts signals back, which takes a fifth of the time.
    asyncio.run(run())
    return made[0]


def stop_at(keyframes):
    """Return an `on_progress` that stops a run after so many keyframes."""
    return lambda mapper, progress: mapper.stop() if progress.keyframes == keyframes else None


def resume_scene(path, source, instances=None):
    """Go on with an interrupted run of the scene, and return the digest of the map."""

    async def run():
        segmenter = InstanceSegmenter(source.instances if instances is None else instances)
        async with Mapper.resuming(
            path, segmenter=segmenter, extractor=MeanColorExtractor(), workers=InProcessWorkers()
        ) as mapper:
            async for _ in mapper.run(source):
                pass
            return mapper.folder.manifest.digest

    return asyncio.run(run())


def shape_workers():
    """Return the shape workers that are children of this process."""
    children = psutil.Process().children(recursive=True)
    return [child for child in children if "hickory_stream.engine.shape_jobs.worker" in _command(child)]


def _command(process):
    try:
        return process.cmdline()
    except (psutil.NoSuchProcess, psutil.ZombieProcess):
        return []


def scene_request(views, *, ticket=1, due_ns=0, num_views=4, views_as=DEFAULT_RUN):
    """Write the views of the tallest box into a folder and return the request for its shape."""
    source = SceneSource(num_views)
    segmenter, config = InstanceSegmenter(source.instances), PerceptionConfig()
    kept, points, colors = [], [], []
    for raw in source.frames():
        frame = raw.decode()
        observation = perceive(frame, None, None, segmenter, config, lattice=Lattice()).observations[-1]
        view = View(
            object_id=3, frame_index=frame.index, stamp_ns=frame.stamp_ns, box_px=observation.box_px,
            world_from_camera=frame.world_from_camera, r_area=observation.r_area, r_depth=observation.r_depth,
            box_volume_m3=observation.box.volume_m3, score=None, variance=None, feature=None,
        )  # fmt: skip
        write_crop(views, view.name, crop_of(frame, observation, 0.08), views_as)
        kept.append(view)
        points.append(observation.points_world)
        colors.append(observation.colors)
    return RequestShape(
        ticket=ticket, object_id=3, views=tuple(kept), points_world=np.concatenate(points),
        colors=np.concatenate(colors), box=gravity_aligned_box(np.concatenate(points), 0.01), support_z_m=0.0,
        due_ns=due_ns,
    )  # fmt: skip
