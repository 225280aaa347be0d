import itertools
from dataclasses import replace
import numpy as np
import pytest
from hickory_stream.fleet.growth import GrownMap, GrowthSink, Rounds
from hickory_stream.geometry.camera import Camera
from hickory_stream.records import Frame, FrameReport, Phase, Segmentation
from tests.alignment.map_fixtures import furniture, snapshot_of

EMPTY = snapshot_of([], np.eye(4))
CAMERA = Camera(width=4, height=3, fx=4.0, fy=4.0, cx=1.5, cy=1.0)
FRAME = Frame(
    index=0, stamp_ns=1, camera=CAMERA, rgb=np.zeros((3, 4, 3), dtype=np.uint8),
    depth_m=np.ones((3, 4), dtype=np.float32), world_from_camera=np.eye(4),
)  # fmt: skip
NOTHING_SEEN = Segmentation(instances=np.zeros((3, 4), dtype=np.int32), structure=np.zeros((3, 4), dtype=bool))


def report(index, *, frame=FRAME, snapshot=EMPTY):
    return FrameReport(
        index=index, stamp_ns=1 + index, keyframe_index=None if snapshot is None else index, camera=CAMERA,
        world_from_camera=np.eye(4), color_bytes=None, frame=frame,
        segmentation=None if frame is None else NOTHING_SEEN, snapshot=snapshot,
    )  # fmt: skip


def grown(keyframes):
    return GrownMap(keyframes=keyframes, snapshot=EMPTY, extractor="", world_from_camera=np.empty((0, 4, 4)))


def rounds_of(order, *, waits=True):
    """Return the rounds of messages in an order: a map after so many keyframes, None for the end."""
    rounds, found = Rounds(["a", "b"], waits=waits), []
    for name, keyframes in order:
        if keyframes is None:
            rounds.end(name)
        else:
            rounds.add(name, grown(keyframes))
        found.extend((r.keyframe, {n: own.keyframes for n, own in r.maps.items()}, r.grown) for r in rounds.complete())
    return found


def test_the_rounds_do_not_depend_on_the_order_of_mapping():
    a = [("a", 5), ("a", 10), ("a", 12), ("a", None)]
    b = [("b", 5), ("b", None)]
    expected = [(5, {"a": 5, "b": 5}, ("a", "b")), (10, {"a": 10, "b": 5}, ("a",)), (12, {"a": 12, "b": 5}, ("a",))]
    for places in itertools.combinations(range(6), len(b)):
        rest, other = iter(a), iter(b)
        assert rounds_of([next(other) if i in places else next(rest) for i in range(6)]) == expected


def test_nobody_waits_for_a_robot_without_a_map_nor_live():
    assert rounds_of([("a", 5), ("b", None), ("a", 9)]) == [(5, {"a": 5}, ("a",)), (9, {"a": 9}, ("a",))]
    found = rounds_of([("a", 5), ("a", 10), ("b", 5)], waits=False)
    assert found == [(5, {"a": 5}, ("a",)), (10, {"a": 10}, ("a",)), (10, {"a": 10, "b": 5}, ("b",))]


@pytest.mark.parametrize(("count", "expected"), [(7, [3, 6, 7]), (6, [3, 6]), (2, [2])])
def test_a_map_is_sent_every_so_many_keyframes_and_at_its_end(count, expected):
    sent = []
    sink = GrowthSink(3, "network", sent.append)
    for index in range(count):
        sink.show(report(index))
        sink.show(report(index, frame=None, snapshot=None))
    sink.close()
    assert [one.keyframes for one in sent] == expected
    assert sum(len(one.world_from_camera) for one in sent) == count
    assert {one.extractor for one in sent} == {"network"}


def test_the_finished_map_is_sent_thinned_and_without_tentative():
    snapshot = snapshot_of(furniture(3, 1), np.eye(4))
    first, *others = snapshot.objects
    points = np.tile(first.points_world, (9, 1))
    large = replace(first, points_world=points, colors=np.zeros((len(points), 3), dtype=np.uint8))
    tentative = replace(others[0], phase=Phase.TENTATIVE)
    sent = []
    sink = GrowthSink(10, "", sent.append)
    sink.show(report(0, frame=None, snapshot=replace(snapshot, objects=(large, tentative, others[1]))))
    sink.close()
    assert [item.id for item in sent[0].snapshot.objects] == [first.id, others[1].id]
    assert len(sent[0].snapshot.objects[0].points_world) == 2000
