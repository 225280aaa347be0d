import asyncio
import numpy as np
import pytest
from rerun.chunk import RrdReader
from hickory_stream.base.config_text import read_config
from hickory_stream.config import MapperConfig
from hickory_stream.engine.mapper import Mapper
from hickory_stream.evaluation.match import match_boxes
from hickory_stream.sinks.rerun.config import RerunConfig
from hickory_stream.sinks.rerun.sink import RerunSink, parse_viewer
from players.live import open_live
from players.opening import open_source
from tests.players.live.live_fixtures import Packet, ScriptedRoute
from tools.benchmarks.common.processes import NO_SHAPES
from tools.benchmarks.live.camera_log import write_b2
from tools.robot.link import Faults, plan
from tools.robot.prepared import prepared


@pytest.fixture(scope="module")
def log(demo_log, tmp_path_factory):
    return write_b2(demo_log, tmp_path_factory.mktemp("b2") / "walk", seconds=2.5, width=640)


def streamed(log, **faults):
    """Return the source of a lossy link that has ended, and what was lost on it by topic."""
    made = plan(prepared([log]), Faults(**faults))
    packets = [Packet(topic=s.due.topic, stamp_ns=s.at_ns, data=s.data) for s in made.sendings]
    route = ScriptedRoute(at_start=packets)
    source = open_live(route.uri, route=route, patience_s=5.0, attempt_s=0.1)
    route.end()
    return source, made.lost


def objects_of(source, out):
    """Return the boxes of a map of all frames, made with a Rerun recording beside it."""

    def sinks(folder):
        return [(RerunSink(RerunConfig(), folder.path, out.with_suffix(".rrd"), parse_viewer("none")), True)]

    async def run():
        async with Mapper(read_config(MapperConfig, None, (NO_SHAPES,)), out=out) as mapper:
            return [snapshot async for snapshot in mapper.run(source, sinks=sinks)][-1]

    objects = asyncio.run(run()).objects
    shown = {chunk.entity_path for chunk in RrdReader(out.with_suffix(".rrd")).stream()}
    assert {f"/world/layer1/{tracked.id}/points" for tracked in objects} <= shown
    return [tracked.box for tracked in objects]


@pytest.mark.parametrize(("seed", "num_frames"), [(2, 11), (7, 10)])
def test_a_streamed_b2_loses_what_its_ledger_says(log, seed, num_frames):
    source, lost = streamed(log, loss=0.1, jitter_s=0.02, seed=seed)
    logged = {frame.stamp_ns: frame for frame in open_source(log).frames()}
    frames = list(source.frames())
    assert (len(frames), len(logged)) == (num_frames, 15)
    for frame in frames:
        assert np.array_equal(frame.decode().depth_m, logged[frame.stamp_ns].decode().depth_m, equal_nan=True)
        # Of poses that were lost, too, those beside the jump are between both places.
        same = np.array_equal(frame.world_from_camera, logged[frame.stamp_ns].world_from_camera)
        assert same or lost["/lio_sam_ros2/mapping/odometry", "loss"]
    account = source.account()
    assert account.as_dict()["difference"] == 0
    rejected = {entry.topic: sum(entry.rejected.values()) for entry in account.topics}
    for name in dict(source.info.streams)["color"], dict(source.info.streams)["depth"]:
        assert num_frames + rejected[name] + lost[name, "loss"] == 15


def test_the_map_of_a_stream_has_the_objects_of_the_replay(log, tmp_path):
    replayed = objects_of(open_source(log), tmp_path / "replayed")
    source, _ = streamed(log, loss=0.02, jitter_s=0.02, seed=1)
    assert len(replayed) >= 5
    assert len(match_boxes(replayed, objects_of(source, tmp_path / "streamed"), 0.25)) >= 0.8 * len(replayed)
