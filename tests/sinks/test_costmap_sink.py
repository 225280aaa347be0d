import io
import os
from dataclasses import replace
from pathlib import Path
import numpy as np
import pytest
from mcap.reader import make_reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from hickory_stream.errors import InputError, OutputError
from hickory_stream.navigation.costmap import Costmap
from hickory_stream.navigation.free_space import obstacle_grid
from hickory_stream.navigation.robot import load_robot
from hickory_stream.records import MapSnapshot
from hickory_stream.sinks.costmap_sink import MAP_TOPIC, UPDATES_TOPIC, CostmapSink
from tests.navigation.rooms import boxes, seen_room, snapshot, table, tracked
from tests.sinks.report_fixtures import bare_report

ROBOT = load_robot("point")


def snapshots():
    """A table comes, a crate comes, moves and goes; in the end the rest of the room is seen."""
    crate, moved = (tracked(2, boxes(((4.5, y, 0.3), (0.3, 0.3, 0.3)))) for y in (1.0, 2.0))
    dark, lit = seen_room(dark_m=(4.0, 4.3)), seen_room()
    chains = [((), dark), ((tracked(1, table()),), dark), ((tracked(1, table()), crate), dark)]
    chains += [((tracked(1, table()), moved), dark), ((tracked(1, table()),), lit)]
    return [
        replace(snapshot(*objects, space=space), revision=i, stamp_ns=10**18 + i)
        for i, (objects, space) in enumerate(chains)
    ]


def applied(updates):
    states = np.zeros(0)
    for update in updates:
        height, width = update.states.shape
        if update.is_whole:
            states = update.states.copy()
        states[update.row : update.row + height, update.column : update.column + width] = update.states
    return states


def test_the_updates_add_up_to_the_grid_of_the_last_snapshot():
    costmap = Costmap(ROBOT, cell_m=0.05, observe_every=1)
    updates = [update for item in snapshots() if (update := costmap.update(item)) is not None]
    assert [update.is_whole for update in updates] == [True, False, False, False, False]
    assert all(update.states.size < updates[0].states.size / 3 for update in updates[1:])
    final = obstacle_grid(snapshots()[-1], ROBOT, cell_m=0.05)
    states, whole = applied(updates), updates[0].frame
    row, column = np.round((final.frame.origin_m - whole.origin_m) / 0.05).astype(int)[::-1]
    rows, columns = final.frame.shape
    assert np.array_equal(states[row : row + rows, column : column + columns], final.states())
    assert costmap.update(snapshots()[-1]) is None


def test_a_map_that_grows_beyond_the_grid_is_sent_whole_again():
    costmap = Costmap(ROBOT, cell_m=0.05)
    assert costmap.update(MapSnapshot(revision=0, stamp_ns=0, submaps=(), objects=())) is None
    first = costmap.update(snapshot())
    far = costmap.update(snapshot(tracked(3, boxes(((9.0, 9.0, 0.3), (0.3, 0.3, 0.3))))))
    assert far.is_whole
    assert far.states.size > first.states.size


def test_the_file_and_the_callable_get_the_same_nav2_messages(tmp_path):
    heard = []
    sink = CostmapSink(ROBOT, path=tmp_path / "costmap.mcap", publish=heard.append)
    sink.show(report(None, 0))
    for i, item in enumerate(snapshots()):
        sink.show(report(item, i))
    sink.close()
    store = get_typestore(Stores.ROS2_HUMBLE)
    with (tmp_path / "costmap.mcap").open("rb") as stream:
        read = list(make_reader(stream).iter_messages())
    assert [channel.topic for _, channel, _ in read] == [MAP_TOPIC] + [UPDATES_TOPIC] * (len(heard) - 1)
    for schema, _, _ in read[:2]:
        if schema.name not in store.types:
            store.register(get_types_from_msg(schema.data.decode(), schema.name))
    for (schema, _, message), update in zip(read, heard, strict=True):
        decoded = store.deserialize_cdr(message.data, schema.name)
        assert message.log_time == update.stamp_ns
        assert np.array_equal(np.asarray(decoded.data).reshape(update.states.shape), update.states)
        if update.is_whole:
            assert (decoded.info.width, decoded.info.height) == update.states.shape[::-1]
            assert [decoded.info.origin.position.x, decoded.info.origin.position.y] == update.frame.origin_m.tolist()
        else:
            assert (decoded.x, decoded.y) == (update.column, update.row)


def test_a_pipe_without_a_reader_holds_nobody_up(tmp_path, caplog):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    sink = CostmapSink(ROBOT, path=pipe)
    assert "waits for a reader" in caplog.text
    sink.show(report(snapshots()[0], 0))
    with os.fdopen(os.open(pipe, os.O_RDONLY | os.O_NONBLOCK), "rb") as reader:
        for i, item in enumerate(snapshots()[1:]):
            sink.show(report(item, i + 1))
        sink.close()
        data = reader.read()
    topics = [channel.topic for _, channel, _ in make_reader(io.BytesIO(data)).iter_messages()]
    assert topics == [MAP_TOPIC] + [UPDATES_TOPIC] * 3


def test_a_reader_of_the_pipe_that_goes_is_waited_for_again(tmp_path, caplog):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    first = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    sink = CostmapSink(ROBOT, path=pipe)
    os.close(first)
    for i, item in enumerate(snapshots()):
        sink.show(report(item, i))
    assert "is gone" in caplog.text
    with os.fdopen(os.open(pipe, os.O_RDONLY | os.O_NONBLOCK), "rb") as second:
        sink.show(report(snapshots()[-1], len(snapshots())))
        sink.close()
        data = second.read()
    assert [channel.topic for _, channel, _ in make_reader(io.BytesIO(data)).iter_messages()] == [MAP_TOPIC]


def test_a_file_that_cannot_be_written_is_refused_at_once(tmp_path):
    with pytest.raises(InputError, match="cannot write the costmap"):
        CostmapSink(ROBOT, path=tmp_path / "no" / "such.mcap")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_costmap_that_the_disk_cut_short_is_told_once():
    sink = CostmapSink(ROBOT, path=Path("/dev/full"))
    with pytest.raises(OutputError, match="/dev/full ends before the map does"):
        sink.show(report(snapshots()[0], 0))
    sink.close()


def report(of, index):
    return bare_report(index, stamp_ns=10**18 + index, keyframe_index=index, snapshot=of)
