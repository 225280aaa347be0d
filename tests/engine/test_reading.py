import asyncio
import json
import threading
import time
from dataclasses import replace
import cv2
import numpy as np
import pytest
from hickory_stream.box_scene import SceneSource
from hickory_stream.config import JournalConfig, MapperConfig
from hickory_stream.engine.async_tools import StopRequest
from hickory_stream.engine.effects import color_of, crop_of
from hickory_stream.engine.keyframe_places import keyframe_surface
from hickory_stream.engine.reading import Reader, sensed
from hickory_stream.errors import ModelError
from hickory_stream.geometry.depth_sensor import DepthSensor, SensorConfig
from hickory_stream.map_folder.history.resume import Position
from hickory_stream.perception.descriptor import ColorTextureDescriptor
from hickory_stream.perception.geometric_segmenter import GeometricConfig, GeometricSegmenter
from hickory_stream.perception.models.shared_runs import IMAGES_A_RUN, SharedRuns
from hickory_stream.perception.perceive import PerceptionConfig, perceive
from hickory_stream.perception.semantic_filter import FilterConfig, FilteredSegmenter
from hickory_stream.perception.surface import Surface
from hickory_stream.records import SemanticImage
from hickory_stream.testing import InstanceSegmenter, MeanColorExtractor
from tests.engine.run_fixtures import NO_SHAPES, NUM_FRAMES, map_scene
from tests.mapping.mapping_fixtures import box_surface, observation

RAW = next(SceneSource(1).frames())
FRAME = RAW.decode()
SEGMENTER = GeometricSegmenter(GeometricConfig())


def test_a_configured_sensor_replaces_the_one_of_the_source(caplog):
    frame = sensed(FRAME, 7, SensorConfig())
    assert (frame.index, frame.sensor) == (7, FRAME.sensor)
    assert frame.depth_m is FRAME.depth_m
    source = replace(FRAME, sensor=DepthSensor(bias_m=0.03, noise_per_m=0.001))
    frame = sensed(source, 0, SensorConfig(bias_m=0.05, max_m=2.5))
    assert frame.sensor == DepthSensor(bias_m=0.05, noise_per_m=0.001, max_m=2.5)
    left = FRAME.depth_m - np.float32(0.02)
    np.testing.assert_allclose(frame.depth_m, np.where(left <= 2.5, left, np.nan), atol=1e-6)
    assert 0 < np.isfinite(frame.depth_m).mean() < np.isfinite(FRAME.depth_m).mean()
    assert not caplog.records
    for index in range(2):
        sensed(replace(FRAME, sensor=frame.sensor), index, SensorConfig(max_m=9.0))
    (warning,) = caplog.messages  # once
    assert "asks for 0.2 to 9 m, but the log's profile keeps depth of 0.2 to 2.5 m" in warning


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


class Shared(InstanceSegmenter):
    """Masks by a network whose runs frames share where `num` is above 1; it may fail on the frame of one brightness."""

    def __init__(self, num, failing=None):
        super().__init__(SCENE.instances)
        self._num, self._failing, self._runs = num, failing, SharedRuns(self._run)
        self.sizes = []

    def share_runs(self):
        return self._num

    def prepare(self, frame):
        image = np.full((1, 3, 1, 1), frame.rgb.mean(), np.float32)
        self._runs.run(image) if self._num > 1 else self._run(image)

    def _run(self, images):
        time.sleep(0.02)  # meanwhile others wait
        self.sizes.append(np.count_nonzero(images[:, 0]))
        if self._failing in images:
            raise ModelError("too bright")
        return [images]


@pytest.mark.parametrize("failing", [None, 2], ids=["all work", "one fails"])
def test_frames_that_share_runs_give_the_same_map(tmp_path, failing):
    failing = failing and np.float32([*SCENE.frames()][failing].decode().rgb.mean())
    segmenters = [Shared(num, failing) for num in (1, IMAGES_A_RUN)]
    options = (*NO_SHAPES, "perception.segmenter=fastsam")
    alone, shared = (
        map_scene(tmp_path, *options, segmenter=one, name=f"{i}").folder for i, one in enumerate(segmenters)
    )
    assert alone.manifest.digest == shared.manifest.digest
    frames = json.loads((shared.path / "ledger.json").read_text())["frames"]
    assert frames.get("keyframes_failed", 0) == (failing is not None)
    assert set(segmenters[0].sizes) == {1}
    assert max(segmenters[1].sizes[2:]) > 1


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


WIDTH, HEIGHT = FRAME.camera.width, FRAME.camera.height


def seen(*box_px):
    x0, y0, x1, y1 = box_px
    return observation(0, box_surface((0, 0, 0)), box_px=(x0, y0, x1, y1))


def test_a_crop_has_a_margin_its_mask_and_a_matching_camera():
    crop = crop_of(FRAME, seen(20, 10, 40, 20), 0.1)
    assert crop.rgb.shape == (10 + 2 * 3, 20 + 2 * 4, 3)
    np.testing.assert_array_equal(crop.rgb, FRAME.rgb[7:23, 16:44])
    np.testing.assert_array_equal(crop.depth_m, FRAME.depth_m[7:23, 16:44])
    assert crop.mask[3:-3, 4:-4].all()
    assert crop.mask.sum() == 10 * 20
    assert (crop.camera.cx, crop.camera.cy) == (FRAME.camera.cx - 16, FRAME.camera.cy - 7)


def test_a_cut_out_ends_where_the_image_does():
    crop = crop_of(FRAME, seen(0, 0, WIDTH, HEIGHT), 0.5)
    np.testing.assert_array_equal(crop.rgb, FRAME.rgb)
    assert crop.mask.all()


@pytest.mark.parametrize("of_log", [b"as it came", None])
def test_the_image_of_the_log_is_kept_or_a_jpeg_is_made(of_log):
    red = replace(FRAME, rgb=np.full_like(FRAME.rgb, (200, 40, 10)))
    kept = color_of(replace(RAW, color_bytes=of_log), red, JournalConfig())
    assert kept is not None
    if of_log is not None:
        assert kept == of_log
    else:
        shown = np.asarray(cv2.imdecode(np.frombuffer(kept, np.uint8), cv2.IMREAD_COLOR))[..., ::-1]
        assert np.abs(shown.astype(int) - red.rgb).max() < 5


def test_no_image_is_kept_where_none_are_to_be():
    assert color_of(replace(RAW, color_bytes=b"x"), FRAME, replace(JournalConfig(), keep_images=False)) is None
