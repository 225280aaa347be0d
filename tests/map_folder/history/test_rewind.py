from dataclasses import replace
from functools import partial
import numpy as np
import pytest
from hickory_stream.box_scene import PERIOD_NS, START_NS, SceneSource
from hickory_stream.errors import MapFolderError
from hickory_stream.journal.reader import Journal
from hickory_stream.map_folder.digest import map_digest
from hickory_stream.map_folder.history.replay import replay
from hickory_stream.map_folder.history.resume import save_live, was_sought
from hickory_stream.map_folder.saved_map import open_map
from hickory_stream.sinks.disk_sink import DiskSink
from hickory_stream.testing import InstanceSegmenter, RememberingSink
from players.playback import PlaybackClock, PlayedSource
from tests.engine.run_fixtures import NO_SHAPES, NUM_FRAMES, map_scene, resume_scene

# Up to the sixth frame, and from the third on again.
BACK_AT, BACK_TO = 6, 2


class SoughtSource(SceneSource):
    """The scene, in which somebody went back: the frames in an order, the first of each new run of them told so."""

    def __init__(self, order):
        super().__init__(NUM_FRAMES)
        self._order = list(order)
        self.num_seeks = 0

    def frames(self):
        scene, last = list(super().frames()), -1
        for index, number in enumerate(self._order):
            goes_back = number < last
            self.num_seeks += goes_back
            decode = partial(lambda raw, index: replace(raw.decode(), index=index), scene[number], index)
            yield replace(scene[number], index=index, decode=decode, goes_back=goes_back)
            last = number


def sought(path, order, *overrides, sink=None, name="map"):
    beside = [] if sink is None else [(sink, True)]
    sinks = {"sinks": lambda folder: [(DiskSink(folder), True), *beside]}
    return map_scene(path, "journal.checkpoint_keyframes=3", *overrides, source=SoughtSource(order), name=name, **sinks)


def there_and_back():
    return [*range(BACK_AT), *range(BACK_TO, NUM_FRAMES)]


def shown_as(snapshot):
    """What a map says of its objects, whatever their numbers and those of the frames."""

    def of(item):
        known = (item.phase, item.sightings, item.first_seen_ns, item.last_seen_ns)
        arrays = (item.points_world.tobytes(), item.box.world_from_box.tobytes())
        best_ns = None if item.best_view is None else item.best_view.stamp_ns
        return (*known, *arrays, [view.stamp_ns for view in item.views], best_ns, item.shape is not None)

    return [of(item) for item in snapshot.objects]


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    return map_scene(tmp_path_factory.mktemp("undisturbed"), *NO_SHAPES)


@pytest.fixture(scope="module")
def gone_back(tmp_path_factory):
    """A run in which somebody went back, and the maps that it published."""
    sink = RememberingSink()
    run = sought(tmp_path_factory.mktemp("back"), there_and_back(), *NO_SHAPES, sink=sink)
    return run, [report.snapshot for report in sink.reports if report.snapshot is not None]


def test_seeking_restores_the_map_and_the_end_is_that_of_no_seek(gone_back, undisturbed):
    run, known = gone_back
    # Seen a third time, and not a seventh: what the first pass knew of the third frame is forgotten.
    assert shown_as(known[BACK_AT]) == shown_as(known[BACK_TO])
    assert shown_as(known[-1]) == shown_as(open_map(undisturbed.folder.path).snapshot)
    revisions = [snapshot.revision for snapshot in known[:-1]]
    assert revisions == sorted(set(revisions))
    assert run.digest == map_digest(known[-1])


def test_the_journal_replays_it_and_knows_both_pasts(gone_back):
    run, known = gone_back
    assert map_digest(replay(run.folder.path)) == run.digest
    with Journal(run.folder.path) as journal:
        steps = [journal.step(i) for i in range(len(journal))]
    assert [step.goes_back_to for step in steps[: BACK_AT + 2]] == [*[None] * BACK_AT, BACK_TO, None]
    # Of a moment that came twice, the second time counts.
    saved = open_map(run.folder.path)
    assert (saved.manifest.is_reproducible, saved.ledger["frames"]["rewinds"]) == (False, 1)
    assert map_digest(saved.as_known_at(START_NS + 4 * PERIOD_NS)) == map_digest(known[BACK_AT + 2])
    assert map_digest(saved.as_known_at(START_NS + PERIOD_NS)) == map_digest(known[1])


def test_going_back_again_and_to_the_very_beginning(tmp_path, undisturbed):
    run = sought(tmp_path, [*there_and_back()[:-2], *range(3, 5), *range(NUM_FRAMES)], *NO_SHAPES)
    assert shown_as(open_map(run.folder.path).snapshot) == shown_as(open_map(undisturbed.folder.path).snapshot)
    assert map_digest(replay(run.folder.path)) == run.digest
    ids = [item.id for item in open_map(run.folder.path).snapshot.objects]
    assert min(ids) > max(item.id for item in open_map(undisturbed.folder.path).snapshot.objects)


def test_open_shapes_are_committed_again_when_due(tmp_path, undisturbed_run):
    run = sought(tmp_path, there_and_back())
    saved = open_map(run.folder.path)
    plain = open_map(undisturbed_run.folder.path)
    shaped, expected = ([o.shape is not None for o in one.snapshot.objects] for one in (saved, plain))
    assert shaped == expected
    assert map_digest(replay(run.folder.path)) == run.digest
    for item in saved.snapshot.objects:
        assert len(saved.mesh(item.shape).vertices) > 0
        assert all((saved.views / f"{view.name}.view").is_file() for view in item.views)


def test_a_stopped_run_with_seeks_is_saved_and_not_resumed(tmp_path):
    stopped = []

    async def stop(mapper, snapshot):
        stopped.append(snapshot)
        if snapshot.revision == BACK_AT + 2:
            mapper.stop()

    source = SoughtSource(there_and_back())
    path = map_scene(tmp_path, *NO_SHAPES, source=source, on_snapshot=stop, rate=2.0).folder.path
    assert was_sought(path)
    with pytest.raises(MapFolderError, match="somebody sought in the log"):
        resume_scene(path, SceneSource(NUM_FRAMES))
    assert save_live(path) == map_digest(open_map(path).snapshot)
    assert len(open_map(path).snapshot.objects) > 0


def test_a_source_sought_by_its_clock_keeps_the_skipped_jumps():
    clock, jump = PlaybackClock(), np.eye(4)
    jump[0, 3] = 0.5

    class Jumping(SceneSource):
        def frames(self):
            for raw in super().frames():
                yield replace(raw, after_from_before=jump) if raw.index in (2, 4) else raw

    shown = []
    for frame in PlayedSource(Jumping(8), clock).frames():
        x_m = None if frame.after_from_before is None else float(frame.after_from_before[0, 3])
        shown.append(((frame.stamp_ns - START_NS) // PERIOD_NS, frame.goes_back, x_m))
        if len(shown) == 2:
            clock.seek(6 * PERIOD_NS / 1e9)
        if len(shown) == 3:
            clock.seek(3 * PERIOD_NS / 1e9)
    back = [(3, True, None), (4, False, 0.5), (5, False, None), (6, False, None), (7, False, None)]
    assert shown == [(0, False, None), (1, False, None), (6, False, 1.0), *back]


def test_lost_pixels_are_known_as_lost_and_others_are_kept(tmp_path):
    run = sought(tmp_path, range(NUM_FRAMES), *NO_SHAPES)
    folder, snapshot = run.folder, open_map(run.folder.path).snapshot
    (first, second, *_) = sorted({view.name for item in snapshot.objects for view in item.views})
    folder.drop_view(first)
    folder.drop_view(second)
    assert folder.keep_views([first, "000099-000"]) == {"000099-000"}
    folder.save(replace(snapshot, objects=()))
    assert (folder.views / f"{first}.view").exists()
    assert not (folder.views / f"{second}.view").exists()


def test_a_person_goes_back_by_the_playback_clock(tmp_path):
    scene = SceneSource(NUM_FRAMES)
    clock = PlaybackClock()
    asked = []

    async def seek(mapper, snapshot):
        if snapshot.revision >= 1 and not asked:
            asked.append(snapshot.revision)
            clock.seek(0.0)
            clock.set_rate(None)

    def mapped(source, name, **watched):
        segmenter = InstanceSegmenter(scene.instances)
        return map_scene(tmp_path, *NO_SHAPES, source=source, segmenter=segmenter, name=name, **watched)

    # At this rate the second frame is due in minutes: only somebody who seeks gets further.
    clock.set_rate(1e-3)
    run = mapped(PlayedSource(scene, clock), "sought", on_snapshot=seek)
    saved = open_map(run.folder.path)
    assert saved.ledger["source"]["seeks"] == 1
    assert saved.ledger["frames"]["rewinds"] == 1
    assert shown_as(saved.snapshot) == shown_as(open_map(mapped(scene, "plain").folder.path).snapshot)
    assert map_digest(replay(run.folder.path)) == run.digest
