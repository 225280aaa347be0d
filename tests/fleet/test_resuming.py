import asyncio
from dataclasses import dataclass, field
import pytest
from hickory_stream.box_scene import SceneSource
from hickory_stream.engine.mapper import Mapper
from hickory_stream.fleet.growth import GrowthSink
from hickory_stream.fleet.resuming import has_ended, send_recorded
from hickory_stream.map_folder.digest import map_digest
from hickory_stream.map_folder.history.replay import show_until_resumed
from hickory_stream.sinks.disk_sink import DiskSink, DiskSinkConfig
from hickory_stream.testing import InstanceSegmenter, MeanColorExtractor, RememberingSink
from tests.engine.run_fixtures import NO_SHAPES, NUM_FRAMES, map_scene
from tests.in_process_workers import InProcessWorkers

EVERY = 2


@dataclass
class Sent:
    maps: list[tuple[int, str, bytes]] = field(default_factory=list)

    def __call__(self, grown):
        self.maps.append((grown.keyframes, map_digest(grown.snapshot), grown.world_from_camera.tobytes()))

    def sink(self):
        return GrowthSink(EVERY, "", self)


def saved_and(growth, folder):
    return [(DiskSink(folder, DiskSinkConfig()), True), (growth, True)]


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A run that was never stopped, and what it sent."""
    sent, path = Sent(), tmp_path_factory.mktemp("whole")
    map_scene(path, *NO_SHAPES, sinks=lambda folder: saved_and(sent.sink(), folder))
    assert len(sent.maps) > 2
    return path / "map", sent


def test_a_robot_that_has_ended_sends_again_what_it_sent(whole):
    folder, sent = whole
    again, beside = Sent(), RememberingSink()
    assert has_ended(folder)
    _, reason = send_recorded(folder, EVERY, again, beside)
    assert reason == ""
    assert again.maps == sent.maps
    assert beside.reports


def test_a_resumed_robot_sends_what_it_had_not_sent(whole, tmp_path):
    def stop(mapper, progress):
        if progress.keyframes == 3:
            mapper.stop()

    map_scene(tmp_path, *NO_SHAPES, on_progress=stop)
    assert not has_ended(tmp_path / "map")
    again = Sent()
    growth = again.sink()
    show_until_resumed(tmp_path / "map", [growth])
    assert 0 < len(again.maps) < len(whole[1].maps)
    assert again.maps == whole[1].maps[: len(again.maps)]

    async def go_on():
        segmenter = InstanceSegmenter(SceneSource(NUM_FRAMES).instances)
        async with Mapper.resuming(
            tmp_path / "map", segmenter=segmenter, extractor=MeanColorExtractor(), workers=InProcessWorkers()
        ) as mapper:
            async for _ in mapper.run(SceneSource(NUM_FRAMES), sinks=lambda folder: saved_and(growth, folder)):
                pass

    asyncio.run(go_on())
    assert again.maps == whole[1].maps
