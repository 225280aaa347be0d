import urllib.request
from contextlib import closing
from dataclasses import replace
import numpy as np
import pytest
from hickory_stream.box_scene import SCENE_CAMERA
from hickory_stream.errors import InputError
from hickory_stream.records import FrameReport
from hickory_stream.sinks.metrics_sink import MetricsSink

REPORT = FrameReport(
    index=0, stamp_ns=1, keyframe_index=None, camera=SCENE_CAMERA, world_from_camera=np.eye(4), color_bytes=None,
    metrics=(("time/perceive", 0.25), ("queue/shapes", 3.0), ("engine/workers", 2.0), ("score/7", 0.5)),
)  # fmt: skip


def read(sink):
    with urllib.request.urlopen(f"http://127.0.0.1:{sink.port}/metrics", timeout=10) as answer:
        lines = answer.read().decode().splitlines()
    return {name: float(value) for name, _, value in (line.rpartition(" ") for line in lines if line[0] != "#")}


def test_the_numbers_of_the_newest_report_are_answered_as_text():
    with closing(MetricsSink(0)) as sink:
        sink.show(REPORT)
        sink.show(replace(REPORT, metrics=(("queue/shapes", 1.0),)))
        numbers = read(sink)
    assert numbers["hickory_frames_total"] == 2
    assert numbers["hickory_keyframes_total"] == 0
    assert numbers['hickory_stage_seconds{stage="perceive"}'] == 0.25
    assert numbers['hickory_queue_length{queue="shapes"}'] == 1
    assert numbers['hickory_engine{what="workers"}'] == 2
    assert not any("score" in name for name in numbers)


def test_topics_of_a_live_route_are_answered_on_request():
    topic = {
        "topic": "/cam/image", "role": "color", "rate_hz": 30.0, "age_s": None, "bytes_per_s": 100, "received": 7,
        "dropped": 2, "lost": 1,
    }  # fmt: skip
    with closing(MetricsSink(0)) as sink:
        sink.watch(lambda: [topic])
        topic["received"] = 8
        numbers = read(sink)
    assert numbers['hickory_live_topic{topic="/cam/image",what="rate_hz"}'] == 30
    assert numbers['hickory_live_topic{topic="/cam/image",what="received"}'] == 8
    assert not any("age_s" in name for name in numbers)


def test_a_port_that_is_taken_is_refused():
    with closing(MetricsSink(0)) as sink, pytest.raises(InputError, match="--metrics-port"):
        MetricsSink(sink.port)
