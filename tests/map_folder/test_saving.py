import json
from dataclasses import replace
import numpy as np
import pytest
from hickory_stream.base.json_text import dumps_exactly
from hickory_stream.geometry.lazy_arrays import give_up
from hickory_stream.geometry.rigid import from_rotation_translation
from hickory_stream.map_folder.codec import encode_snapshot
from hickory_stream.map_folder.writer import ReferencedNames, SnapshotEncoder
from tests.engine.snapshot_fixtures import make_snapshot

SNAPSHOT = make_snapshot()


def series():
    """A map; the same later; with one object changed, without one, with one that has other points, and empty."""
    first, *others = SNAPSHOT.objects
    assert others
    moved = replace(first, points_world=first.points_world + np.float32(1), views=(), best_view=None)
    return [
        SNAPSHOT, replace(SNAPSHOT, revision=9, stamp_ns=77),
        replace(SNAPSHOT, objects=(replace(first, sightings=first.sightings + 1), *others)),
        replace(SNAPSHOT, objects=tuple(others)), replace(SNAPSHOT, objects=(moved, *others)),
        replace(SNAPSHOT, objects=(), submaps=()), SNAPSHOT,
    ]  # fmt: skip


def test_it_is_the_whole_document_and_its_changes_add_up():
    encoder, on_disk = SnapshotEncoder(), {}
    for i, snapshot in enumerate(series()):
        new = {}
        encoded = encoder.encoded(snapshot, new.__setitem__)
        document, files = encode_snapshot(snapshot)
        assert encoded.document == dumps_exactly(document).encode()
        on_disk |= new
        assert encoded.gone.isdisjoint(files)
        for name in encoded.gone:
            del on_disk[name]
        assert on_disk == files
        assert encoder.files == set(files)
        assert (new == {}) == (i in (1, 3, 5))


def test_views_and_meshes_of_a_snapshot_are_followed():
    referenced, before = ReferencedNames(), set()
    for snapshot in series():
        wanted = {f"views/{view.name}" for tracked in snapshot.objects for view in tracked.views}
        shapes = [tracked.shape for tracked in snapshot.objects]
        wanted |= {f"shapes/{shape.mesh_name}" for shape in shapes if shape is not None}
        assert set(referenced.follow(snapshot)) == wanted - before
        assert {name for name in before | wanted if name in referenced} == set(referenced) == wanted
        before = wanted


def test_a_moved_submap_keeps_its_files_without_reading_voxels():
    snapshot, encoder = make_snapshot(), SnapshotEncoder()
    first, *others = snapshot.submaps
    encoder.encoded(snapshot, lambda name, data: None)
    placed = replace(first, world_from_submap=from_rotation_translation(np.eye(3), np.array([1.0, 2.0, 3.0])))
    give_up(placed.observed_space, never_asked, "free", "structure")
    moved = replace(snapshot, submaps=(placed, *others))
    encoded = encoder.encoded(moved, lambda name, data: pytest.fail(f"{name} was written again"))
    assert json.loads(encoded.document)["submaps"][0]["world_from_submap"][0][3] == 1.0
    assert encoded.gone == set()


def never_asked(name):
    """Voxels that nobody may ask for."""
    raise AssertionError(f"{name} was read")


def test_points_of_equal_parts_are_neither_made_nor_rewritten():
    asked = []
    cloud, other_cloud = object(), object()
    first, *others = SNAPSHOT.objects

    def made_of(of, sightings):
        one = replace(first, sightings=sightings)

        def make(name):
            asked.append(name)
            return getattr(first, name)

        give_up(one, make, "points_world", "colors", of=(of,))
        return replace(SNAPSHOT, objects=(one, *others))

    encoder, new = SnapshotEncoder(), dict[str, bytes]()
    encoder.encoded(made_of(cloud, 5), new.__setitem__)
    assert sorted(asked) == ["colors", "points_world"]
    asked.clear()
    new.clear()
    later = encoder.encoded(made_of(cloud, 6), new.__setitem__)
    assert (asked, new, later.gone) == ([], {}, frozenset())
    expected, _ = encode_snapshot(replace(SNAPSHOT, objects=(replace(first, sightings=6), *others)))
    assert later.document == dumps_exactly(expected).encode()
    encoder.encoded(made_of(other_cloud, 6), new.__setitem__)
    assert sorted(asked) == ["colors", "points_world"]
