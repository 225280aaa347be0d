import asyncio
import pytest
from threadpoolctl import threadpool_info, threadpool_limits
from hickory_stream.box_scene import SceneSource
from hickory_stream.engine.mapper import Mapper
from hickory_stream.errors import RecordingError, ViewerError
from hickory_stream.map_folder.saved_map import open_map
from players.faults import Faults, FaultySource
from tests.engine.run_fixtures import NO_SHAPES, NUM_FRAMES, map_scene, shape_workers


def test_snapshots_come_in_order_and_the_last_is_the_saved_map(tmp_path):
    run = map_scene(tmp_path, *NO_SHAPES)
    revisions = [snapshot.revision for snapshot in run.snapshots]
    assert revisions == sorted(revisions)
    saved = open_map(run.folder.path).snapshot
    assert saved.revision == revisions[-1]
    assert [tracked.id for tracked in saved.objects] == [tracked.id for tracked in run.snapshots[-1].objects]


def test_a_slow_consumer_sees_the_newest_map_and_always_the_last(tmp_path):
    async def linger(mapper, snapshot):
        if snapshot.revision == 1:
            while not mapper.folder.manifest.finished_cleanly:  # noqa: ASYNC110 -- the end of a run is no event
                await asyncio.sleep(0.01)

    run = map_scene(tmp_path, *NO_SHAPES, on_snapshot=linger)
    assert len(run.snapshots) == 2
    assert run.snapshots[-1].revision == NUM_FRAMES


def test_a_temporary_map_folder_exists_while_mapping_only():
    async def run():
        async with Mapper() as mapper:
            async for _ in mapper.run(SceneSource(2)):
                pass
            assert open_map(mapper.folder.path).manifest.finished_cleanly
            return mapper.folder.path

    assert not asyncio.run(run()).exists()


def test_leaving_the_loop_early_ends_the_run_and_saves_the_map(tmp_path):
    complaints = []

    async def run():
        asyncio.get_running_loop().set_exception_handler(lambda _, context: complaints.append(context))
        async with Mapper(out=tmp_path / "map") as mapper:
            async for _ in mapper.run(SceneSource(8)):
                break
        assert mapper.was_stopped

    asyncio.run(run())
    saved = open_map(tmp_path / "map")
    assert not saved.manifest.finished_cleanly
    assert saved.ledger["frames"]["read"] >= 1
    assert complaints == []


@pytest.mark.parametrize("is_broken", [False, True])
def test_leaving_the_loop_early_leaves_no_temporary_folder(is_broken):
    complaints, folders = [], []

    async def run():
        asyncio.get_running_loop().set_exception_handler(lambda _, context: complaints.append(context))
        async with Mapper() as mapper:
            async for _ in mapper.run(SceneSource(8)):
                folders.append(mapper.folder.path)
                if is_broken:
                    raise KeyError("what the consumer looked for")
                break

    if is_broken:
        with pytest.raises(KeyError, match="consumer"):
            asyncio.run(run())
    else:
        asyncio.run(run())
    assert not folders[0].exists()
    assert complaints == []


def test_linear_algebra_has_one_thread_while_mapping_only():
    def threads():
        return [pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"]

    async def run():
        async with Mapper():
            return threads()

    with threadpool_limits(limits=2, user_api="blas"):
        assert set(asyncio.run(run())) == {1}
        assert set(threads()) == {2}


def test_a_consumer_that_leaves_early_leaves_a_map_and_no_child(tmp_path):
    async def leave(mapper, snapshot):
        if snapshot.revision >= 4:
            raise InterruptedError

    with pytest.raises(InterruptedError):
        map_scene(tmp_path, on_snapshot=leave, child_workers=True)
    assert not open_map(tmp_path / "map").manifest.finished_cleanly
    assert shape_workers() == []


@pytest.mark.parametrize(
    ("source", "told"),
    [
        (SceneSource(0), r"memory:scene gave no usable frame \(frames 0\)"),
        (
            FaultySource(SceneSource(NUM_FRAMES), Faults(blind=1.0)),
            rf"memory:scene has no depth in any of {NUM_FRAMES} keyframes",
        ),
    ],
)
def test_a_source_without_frames_or_depth_leaves_no_map(tmp_path, source, told):
    with pytest.raises(RecordingError, match=told):
        map_scene(tmp_path, source=source)
    assert not (tmp_path / "map").exists()


def test_a_sink_that_cannot_be_made_leaves_no_map(tmp_path):
    def fail(folder):
        raise ViewerError("there is no screen")

    with pytest.raises(ViewerError, match="no screen"):
        map_scene(tmp_path, sinks=fail)
    assert not (tmp_path / "map").exists()
