import asyncio
import json
import threading
from dataclasses import replace
import numpy as np
import pytest
from hickory_stream.box_scene import SceneSource
from hickory_stream.config import MapperConfig
from hickory_stream.engine.async_tools import StopRequest
from hickory_stream.engine.reading import Reader
from hickory_stream.errors import ModelError
from hickory_stream.map_folder.history.resume import Position
from hickory_stream.perception.perceive import PerceptionConfig
from hickory_stream.perception.semantic_filter import FilterConfig, FilteredSegmenter
from hickory_stream.records import SemanticImage
from hickory_stream.testing import InstanceSegmenter, MeanColorExtractor
from tests.engine.run_fixtures import NO_SHAPES, NUM_FRAMES, map_scene

NETWORKS = PerceptionConfig(segmenter="fastsam", extractor="dinov2", semantics="oneformer")
SCENE = SceneSource(NUM_FRAMES)


class Device(InstanceSegmenter, MeanColorExtractor):
    """Networks of masks, features and classes that wait, by their names; some of the calls for masks may fail."""

    labels = ("wall",)

    def __init__(self, waits, failing=()):
        super().__init__(SCENE.instances)
        self._waits, self._failing, self._num_calls = waits, failing, 0

    def prepare(self, frame):
        self._waits("masks")
        self._num_calls += 1
        if self._num_calls in self._failing:
            raise ModelError("the device is gone")

    def extract(self, rgb):
        self._waits("features")
        return super().extract(rgb)

    def classify(self, rgb):
        self._waits("classes")
        return SemanticImage(classes=np.full(rgb.shape[:2], -1, np.int32), labels=self.labels)


def frames_read(segmenter, extractor):
    async def read():
        config = replace(MapperConfig(), perception=NETWORKS)
        reader = Reader(config, segmenter, extractor, StopRequest(), mode="playback")
        taken = []
        async with asyncio.TaskGroup() as group:
            group.create_task(reader.read(SCENE, rate=None, loops=1, start=Position()))
            while (some := await reader.take()) is not None:
                taken += some
        reader.close()
        return taken

    return asyncio.run(read())


def test_masks_features_and_classes_of_a_frame_run_side_by_side():
    # Each network goes on only while the two others are at work, too; one after the other, the barrier breaks.
    barrier = threading.Barrier(3, timeout=20)
    device = Device(lambda _: barrier.wait())
    masks = FilteredSegmenter(device, device, FilterConfig(structure=("wall",), dynamic=()))
    keyframes = [read for read in frames_read(masks, device) if read.is_candidate]
    assert len(keyframes) >= 2
    assert all(read.ahead.prepared is not None and read.ahead.patches is not None for read in keyframes)


def test_the_next_frame_enters_a_network_that_is_free():
    # Masks of the first frame take until the features of the second are there.
    calls, has_second = [], threading.Event()

    def waits(network):
        calls.append(network)
        if calls.count("features") == 2:
            has_second.set()
        assert network == "features" or has_second.wait(timeout=20)

    keyframes = [read for read in frames_read(Device(waits), Device(waits)) if read.is_candidate]
    assert [read.raw.index for read in keyframes] == sorted(read.raw.index for read in keyframes)
    assert len(keyframes) >= 2


@pytest.mark.parametrize(("mode", "rate"), [("playback", None), ("live", 3.0)])
def test_a_network_that_fails_in_a_frame_costs_that_frame(tmp_path, caplog, mode, rate):
    run = map_scene(tmp_path, *NO_SHAPES, segmenter=Device(lambda _: None, failing={2}), mode=mode, rate=rate)
    frames = json.loads((run.folder.path / "ledger.json").read_text())["frames"]
    assert frames["keyframes_failed"] == 1
    assert frames["keyframes"] >= 1
    assert sum(frames.values()) == 2 * frames["read"]
    assert "is left out: the device is gone" in caplog.text


@pytest.mark.parametrize("mode", ["playback", "live"])
def test_a_network_that_never_worked_ends_the_run(tmp_path, mode):
    with pytest.raises(ModelError, match="the device is gone"):
        map_scene(tmp_path, *NO_SHAPES, segmenter=Device(lambda _: None, failing=range(1, 99)), mode=mode)
