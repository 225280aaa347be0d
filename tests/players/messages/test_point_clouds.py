from types import SimpleNamespace
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hickory_stream.errors import RecordingError
from players import open_source
from players.messages.point_clouds import scan_of
from tests import player_scenes as scenes

POINTS = np.float32([[1, 2, 3], [4, 5, 6], [np.nan, 0, 0], [7, 8, 9], [1, np.inf, 1], [10, 11, 12]])
FINITE = [0, 1, 3, 5]
STAMP_NS = 1_700_000_000_250_000_000
_NUMBERS = {"i1": 1, "u1": 2, "i2": 3, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8}


def cloud(columns, *, rows=1, gap=0, row_gap=0, big=False):
    """A message of named columns (type, values), each `gap` bytes behind the one before, in `rows` rows."""
    fields, at = [], gap
    for name, (kind, _) in columns.items():
        fields.append(SimpleNamespace(name=name, offset=at, datatype=_NUMBERS[kind], count=1))
        at += np.dtype(kind).itemsize + gap
    width = len(POINTS) // rows
    row_step = at * width + row_gap
    data = np.zeros((rows, row_step), dtype=np.uint8)
    for field, (kind, values) in zip(fields, columns.values(), strict=True):
        size = np.dtype(kind).itemsize
        raw = np.asarray(values).astype((">" if big else "<") + kind).reshape(rows, width)
        for i in range(width):
            start = i * at + field.offset
            data[:, start : start + size] = np.ascontiguousarray(raw[:, i : i + 1]).view(np.uint8)
    stamp = SimpleNamespace(sec=STAMP_NS // 10**9, nanosec=STAMP_NS % 10**9)
    return SimpleNamespace(
        header=SimpleNamespace(stamp=stamp, frame_id="/velodyne"), height=rows, width=width, fields=fields,
        is_bigendian=big, point_step=at, row_step=row_step, data=data.ravel(),
    )  # fmt: skip


def fields_of_type(number):
    return [SimpleNamespace(name=axis, offset=4 * i, datatype=number, count=1) for i, axis in enumerate("xyz")]


def xyz(kind="f4"):
    return {axis: (kind, POINTS[:, i]) for i, axis in enumerate("xyz")}


@given(
    st.sampled_from(["f4", "f8"]), st.sampled_from([1, 2, 3]), st.integers(0, 9), st.integers(0, 9), st.booleans(),
    st.permutations(["x", "y", "z", "intensity"]),
)  # fmt: skip
def test_points_are_read_wherever_they_lie(kind, rows, gap, row_gap, big, order):
    columns = {**xyz(kind), "intensity": ("u2", np.arange(6))}
    scan = scan_of(cloud({name: columns[name] for name in order}, rows=rows, gap=gap, row_gap=row_gap, big=big))
    assert np.array_equal(scan.points, POINTS[FINITE])
    assert (scan.stamp_ns, scan.frame, scan.times_s) == (STAMP_NS, "velodyne", None)


SINCE_S = np.arange(6) * 0.01


@pytest.mark.parametrize(("name", "kind", "values"), [
    ("t", "u4", 1e9 * SINCE_S), ("offset_time", "u4", 1e9 * SINCE_S), ("time", "f4", SINCE_S),
    ("timestamp", "f8", STAMP_NS / 1e9 + SINCE_S),
])  # fmt: skip
def test_the_time_of_a_point_is_told_since_the_stamp(name, kind, values):
    assert scan_of(cloud({**xyz(), name: (kind, values)})).times_s == pytest.approx([0.0, 0.01, 0.03, 0.05], abs=1e-6)


def test_times_that_are_none_are_not_told():
    assert scan_of(cloud({**xyz(), "time": ("f4", np.full(6, np.nan))})).times_s is None
    assert scan_of(cloud({**xyz(), "timestamp": ("f8", np.full(6, 12_345.0))})).times_s is None


def test_a_single_row_needs_no_length_and_a_cloud_may_be_empty():
    message = cloud(xyz())
    message.row_step = 0
    assert len(scan_of(message).points) == len(FINITE)
    message.width, message.data = 0, np.zeros(0, np.uint8)
    assert scan_of(message).points.shape == (0, 3)
    message.height = 0
    assert scan_of(message).points.shape == (0, 3)


@pytest.mark.parametrize(("change", "said"), [
    ({"data": np.zeros(10, np.uint8)}, "has 10 bytes in rows of 72; 1 x 6 points of 12 bytes need 72"),
    ({"width": 7}, "1 x 7 points of 12 bytes need 84"),
    ({"width": 2**31, "height": 2**20}, "over the limit"),
    ({"point_step": 8}, "field z ends at byte 12 of 8"),
    ({"fields": []}, "has no x, y, z; its fields are none"),
    ({"fields": fields_of_type(9)}, "field x is of the unknown type 9"),
])  # fmt: skip
def test_a_cloud_that_contradicts_itself_is_refused(change, said):
    message = cloud(xyz())
    for name, value in change.items():
        setattr(message, name, value)
    with pytest.raises(RecordingError, match=said):
        scan_of(message)


@pytest.mark.parametrize("ros", [1, 2])
def test_a_log_passes_scans_on_and_skips_a_corrupt_one(tmp_path, ros, caplog):
    m, frames = scenes.Messages(ros), scenes.make_scene()
    messages = scenes.scene_messages(m, frames, scenes.raw_images)
    for i, frame in enumerate(frames[:3]):
        plain = cloud({**xyz(), "time": ("f4", np.arange(6) * 0.01)})
        fields = [m.make("sensor_msgs/msg/PointField", **vars(field)) for field in plain.fields]
        data = plain.data[:20] if i == 1 else plain.data
        message = m.make(
            "sensor_msgs/msg/PointCloud2", header=m.header(frame.stamp_ns, "lidar"), height=1, width=6, fields=fields,
            is_bigendian=False, point_step=plain.point_step, row_step=plain.row_step, data=data, is_dense=False,
        )  # fmt: skip
        messages.append(scenes.Message(topic="/lidar_points", stamp_ns=frame.stamp_ns, message=message))
    messages.sort(key=lambda message: message.stamp_ns)
    write = scenes.write_ros1 if ros == 1 else scenes.write_ros2
    source = open_source(write(tmp_path / ("log.bag" if ros == 1 else "log"), m, messages))
    scans = list(source.scans("/lidar_points"))
    assert [scan.stamp_ns for scan in scans] == [frames[0].stamp_ns, frames[2].stamp_ns]
    assert all(np.array_equal(scan.points, POINTS[FINITE]) for scan in scans)
    assert "a sweep at" in caplog.text
    with pytest.raises(RecordingError, match="has no point clouds in /odom; those of point clouds are /lidar_points"):
        next(source.scans("/odom"))
