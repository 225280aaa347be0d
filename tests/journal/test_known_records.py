from dataclasses import replace
import pytest
from hickory_stream.errors import MapFolderError
from hickory_stream.journal.reader import Journal
from hickory_stream.journal.record_codec import encode
from hickory_stream.journal.snapshot_records import object_without_points
from hickory_stream.journal.writer import JournalWriter
from hickory_stream.records import TrackedObject
from tests.engine.snapshot_fixtures import make_snapshot
from tests.journal.test_journal import entry

NUM_MAPS = 40


def maps():
    """Maps one after another, each with an object that was seen once more, some without one of the others."""
    whole = make_snapshot()
    found = []
    objects = list(whole.objects)
    for i in range(NUM_MAPS):
        at = i % len(objects)
        objects[at] = replace(objects[at], sightings=objects[at].sightings + i)
        missing = {objects[(i // 3) % len(objects)].id} if i % 5 == 3 else set()
        shown = tuple(tracked for tracked in objects if tracked.id not in missing)
        found.append(replace(whole, revision=i, stamp_ns=1000 + i, objects=shown))
    return found


def written(journal, index):
    known = journal.known(index)
    assert known.revision == index
    return {key: encode(journal.known_record(place, TrackedObject)) for key, place in known.objects.items()}


def expected(snapshot):
    return {tracked.id: encode(object_without_points(tracked)) for tracked in snapshot.objects}


def test_the_records_of_a_step_are_its_maps_and_written_once(tmp_path):
    snapshots = maps()
    writer = JournalWriter(tmp_path, flush_s=60.0)
    for i, snapshot in enumerate(snapshots[:25]):
        writer.append(entry(i), known=snapshot)
    writer.close()
    with Journal(tmp_path) as journal:
        writer = JournalWriter(tmp_path, flush_s=60.0, continued=journal)
    for i, snapshot in enumerate(snapshots[25:], 25):
        writer.append(entry(i), known=snapshot)
    writer.close()
    with Journal(tmp_path) as journal:
        for i, snapshot in enumerate(snapshots):
            assert written(journal, i) == expected(snapshot)
        before, after = journal.known(3), journal.known(4)
        assert len(before.submaps.keys() & after.submaps.keys()) > 0
        assert before.submaps == after.submaps
        assert 0 < len(after.objects.items() - before.objects.items()) <= 2
        # A view is one record, whoever has it, so that the best one is among the others.
        seen = [journal.known_record(place, TrackedObject) for place in after.objects.values()]
        assert any(one.best_view is not None for one in seen)
        assert all(one.best_view is None or any(one.best_view is view for view in one.views) for one in seen)


def test_a_journal_without_records_has_none(tmp_path):
    writer = JournalWriter(tmp_path, flush_s=60.0)
    for i, snapshot in enumerate(maps()[:4]):
        writer.append(entry(i), **({"known": snapshot} if i in (1, 2) else {}))
    writer.close()
    with Journal(tmp_path) as journal:
        for index in (0, 3):
            with pytest.raises(MapFolderError, match=f"has no records of step {index}"):
                journal.known(index)
        for place in ((99, 1), (-1, 1), (0, 1), (1, 0), (1, 99)):
            with pytest.raises(MapFolderError, match="is damaged"):
                journal.known_record(place, TrackedObject)
