import asyncio
from dataclasses import replace
import numpy as np
from hickory_stream.box_scene import SceneSource
from hickory_stream.config import MapperConfig
from hickory_stream.engine.async_tools import StopRequest
from hickory_stream.engine.keyframe_places import keyframe_surface
from hickory_stream.engine.reading import Reader, sensed
from hickory_stream.geometry.depth_sensor import DepthSensor, SensorConfig
from hickory_stream.map_folder.history.resume import Position
from hickory_stream.perception.descriptor import ColorTextureDescriptor
from hickory_stream.perception.geometric_segmenter import GeometricConfig, GeometricSegmenter
from hickory_stream.perception.perceive import perceive
from hickory_stream.perception.surface import Surface

RAW = next(SceneSource(1).frames())
FRAME = RAW.decode()
SEGMENTER = GeometricSegmenter(GeometricConfig())


def test_a_configured_sensor_replaces_the_one_of_the_source():
    frame = sensed(FRAME, 7, SensorConfig())
    assert (frame.index, frame.sensor) == (7, FRAME.sensor)
    assert frame.depth_m is FRAME.depth_m
    source = replace(FRAME, sensor=DepthSensor(bias_m=0.03, noise_per_m=0.001))
    frame = sensed(source, 0, SensorConfig(bias_m=0.05, max_m=2.5))
    assert frame.sensor == DepthSensor(bias_m=0.05, noise_per_m=0.001, max_m=2.5)
    left = FRAME.depth_m - np.float32(0.02)
    np.testing.assert_allclose(frame.depth_m, np.where(left <= 2.5, left, np.nan), atol=1e-6)
    assert 0 < np.isfinite(frame.depth_m).mean() < np.isfinite(FRAME.depth_m).mean()


def test_a_playback_keyframe_comes_with_all_that_needs_no_map():
    reads = asyncio.run(_read(SceneSource(4)))
    assert [read for read in reads if read.is_candidate]
    config = MapperConfig()
    for read in reads:
        if read.frame is None:
            assert read.ahead.prepared is None
            continue
        ahead, frame = read.ahead, read.frame
        assert isinstance(ahead.prepared, Surface)
        np.testing.assert_array_equal(ahead.patches, ColorTextureDescriptor().extract(frame.rgb))
        np.testing.assert_array_equal(ahead.surface.points, keyframe_surface(frame).points)
        alone = perceive(frame, None, None, SEGMENTER, config.perception, lattice=config.mapping.voxels)
        np.testing.assert_array_equal(ahead.free_keys, alone.space.free_keys)


def test_at_30_hz_the_next_keyframe_is_ready_in_advance():
    async def ready():
        reader = _reader()
        await _reading(reader, SceneSource(16, period_ns=33_333_333))
        reads = await _taken(reader)
        reader.close()
        return reads

    assert [read.raw.index for read in asyncio.run(ready()) if read.frame is not None] == [0, 8]


def test_few_keyframes_wait_decoded_and_a_waiting_reader_ends():
    async def left():
        reader = _reader()
        async with asyncio.TaskGroup() as group:
            group.create_task(_reading(reader, SceneSource(12)))
            while reader.num_waiting < 3:  # noqa: ASYNC110 (what is on its way is counted, not told)
                await asyncio.sleep(0)
            await reader.end()
        reads = await _taken(reader)
        reader.close()
        return reads

    assert len(asyncio.run(left())) == 3


async def _read(source):
    reader = _reader()
    async with asyncio.TaskGroup() as group:
        group.create_task(_reading(reader, source))
        reads = await _taken(reader)
    reader.close()
    return reads


def _reader():
    return Reader(MapperConfig(), SEGMENTER, ColorTextureDescriptor(), StopRequest(), mode="playback")


async def _reading(reader, source):
    await reader.read(source, rate=None, loops=1, start=Position())


async def _taken(reader):
    taken = []
    while (some := await reader.take()) is not None:
        taken += some
    return taken
