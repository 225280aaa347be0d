"""Saving one snapshot after another gives the document of the whole, and only the files that are new."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from hickory_stream.engine.crops import crop_files
from hickory_stream.engine.map_codec import encode_snapshot
from hickory_stream.engine.saving import ReferencedFiles, SnapshotEncoder
from hickory_stream.json_text import dumps_exactly
from hickory_stream.records import MapSnapshot
from tests.engine.snapshot_fixtures import make_snapshot

SNAPSHOT = make_snapshot()


def series() -> list[MapSnapshot]:
    """A map; the same later; with one object changed, without one, with one that has other points, and empty."""
    first, *others = SNAPSHOT.objects
    assert others
    moved = replace(first, points_world=first.points_world + np.float32(1), views=(), best_view=None)
    return [
        SNAPSHOT,
        replace(SNAPSHOT, revision=9, stamp_ns=77),
        replace(SNAPSHOT, objects=(replace(first, sightings=first.sightings + 1), *others)),
        replace(SNAPSHOT, objects=tuple(others)),
        replace(SNAPSHOT, objects=(moved, *others)),
        replace(SNAPSHOT, objects=(), submaps=()),
        SNAPSHOT,
    ]


def test_it_is_the_document_of_the_whole_and_what_is_new_and_gone_adds_up_to_its_files() -> None:
    encoder, on_disk = SnapshotEncoder(), {}
    for i, snapshot in enumerate(series()):
        encoded = encoder.encoded(snapshot)
        document, files = encode_snapshot(snapshot)
        assert encoded.document == dumps_exactly(document).encode()
        on_disk |= encoded.new
        assert encoded.gone.isdisjoint(files)
        for name in encoded.gone:
            del on_disk[name]
        assert on_disk == files
        assert encoder.files == set(files)
        assert (encoded.new == {}) == (i in (1, 3, 5))


def test_the_files_that_a_snapshot_refers_to_are_followed(tmp_path: Path) -> None:
    referenced, before = ReferencedFiles(tmp_path), set()
    for snapshot in series():
        views = [view.name for tracked in snapshot.objects for view in tracked.views]
        wanted = {file for name in views for file in crop_files(tmp_path / "views", name)}
        shapes = [tracked.shape for tracked in snapshot.objects]
        wanted |= {tmp_path / "shapes" / shape.mesh_name for shape in shapes if shape is not None}
        assert set(referenced.follow(snapshot)) == wanted - before
        assert {file for file in before | wanted if file in referenced} == wanted
        before = wanted
