import json
import os
import resource
import shutil
import signal
import sys
from dataclasses import replace
import numpy as np
import pytest
from hickory_stream.errors import HickoryError, MapFolderError
from hickory_stream.geometry.lazy_arrays import has_given_up
from hickory_stream.geometry.mesh import mesh_of_glb
from hickory_stream.map_folder.digest import map_digest
from hickory_stream.map_folder.manifest import FORMAT_VERSION
from hickory_stream.map_folder.saved_map import open_map
from hickory_stream.map_folder.writer import MapFolder, create_map_folder
from tests.engine.snapshot_fixtures import make_snapshot

CONFIG = {"keyframes": {"min_gap_s": 0.25}}
SOURCE = {"uri": "desk.mcap", "identity": "abc"}


def create(path, *, overwrite=False):
    return create_map_folder(path, config=CONFIG, source=SOURCE, overwrite=overwrite)


def files_of(path):
    return sorted(str(file.relative_to(path)) for file in path.rglob("*") if file.is_file())


def test_a_saved_map_opens_as_the_map_that_was_saved(tmp_path):
    folder = create(tmp_path / "m")
    empty = open_map(tmp_path / "m")
    assert (empty.snapshot.objects, empty.manifest.finished_cleanly) == ((), False)
    snapshot = make_snapshot(folder)
    first = snapshot.objects[0]
    # A number that JSON does not know.
    unbounded = replace(first.shape, containment=replace(first.shape.containment, max_g=float("inf")))
    snapshot = replace(snapshot, objects=(replace(first, shape=unbounded), *snapshot.objects[1:]))
    folder.save(snapshot)
    folder.write_json("ledger.json", {"frames": 120})
    folder.write_json("timings.json", {"layer2_s": 0.5})
    folder.finish(finished_cleanly=True)
    saved = open_map(tmp_path / "m")
    assert map_digest(saved.snapshot) == map_digest(snapshot) == saved.manifest.digest
    assert (saved.manifest.config, saved.manifest.source, saved.manifest.finished_cleanly) == (CONFIG, SOURCE, True)
    assert (saved.ledger, saved.timings) == ({"frames": 120}, {"layer2_s": 0.5})
    assert saved.snapshot.stamp_ns == snapshot.stamp_ns
    space, expected = (one.submaps[0].observed_space for one in (saved.snapshot, snapshot))
    assert np.array_equal(space.free, expected.free) and np.array_equal(space.structure, expected.structure)
    shape = saved.snapshot.objects[0].shape
    assert len(saved.mesh(shape).faces) == len(mesh_of_glb(saved.mesh_path(shape).read_bytes()).faces) == 48


def test_files_of_unchanged_objects_are_not_written_again(tmp_path):
    folder = create(tmp_path / "m")
    snapshot = make_snapshot(folder)
    folder.save(snapshot)
    before = {file.name: file.stat().st_ino for file in (tmp_path / "m/points").iterdir()}
    moved = replace(snapshot.objects[0], points_world=snapshot.objects[0].points_world + np.float32(0.1))
    folder.save(replace(snapshot, objects=(moved, *snapshot.objects[1:])))
    after = {file.name: file.stat().st_ino for file in (tmp_path / "m/points").iterdir()}
    assert len(before) == len(after) == 3
    assert len(before.items() & after.items()) == 2


def in_child(action, prepare):
    """Run in a forked child; return 0 for done, 1 for refused with a clear message, 2 otherwise, 9 for killed."""
    child = os.fork()
    if child == 0:
        status = 2
        try:
            prepare()
            action()
            status = 0
        except HickoryError as error:
            status = 1 if "choose another --out" in str(error) else 2
        finally:
            os._exit(status)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def die_at(step):
    """Return what makes this process die before its `step`-th operation on files."""
    seen = 0

    def count(event, _):
        nonlocal seen
        if event in ("open", "os.rename", "os.remove", "os.mkdir", "os.rmdir"):
            seen += 1
            if seen > step:
                os._exit(9)

    return lambda: sys.addaudithook(count)


def limit_file_size(size):
    def prepare():
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, resource.RLIM_INFINITY))

    return prepare


@pytest.fixture
def old_and_new(tmp_path):
    """A saved map in `tmp_path/old`, its digest, and that of the map that `save_next` saves."""
    folder = create(tmp_path / "old")
    snapshot = make_snapshot(folder)
    folder.save(snapshot)
    return tmp_path / "old", map_digest(snapshot), map_digest(next_snapshot())


def next_snapshot():
    snapshot = make_snapshot()
    shifted = [replace(tracked, points_world=tracked.points_world + np.float32(1)) for tracked in snapshot.objects]
    return replace(snapshot, revision=4, objects=tuple(shifted))


def save_next(path):
    MapFolder(path, open_map(path).manifest).save(next_snapshot())


def test_a_save_killed_at_any_step_opens_as_before_or_after(old_and_new, tmp_path):
    old, old_digest, new_digest = old_and_new
    found = []
    status, step = 9, 0
    while status == 9:
        shutil.copytree(old, tmp_path / "m")
        status = in_child(lambda: save_next(tmp_path / "m"), die_at(step))
        found.append(map_digest(open_map(tmp_path / "m").snapshot))
        assert found[-1] in (old_digest, new_digest), step
        save_next(tmp_path / "m")
        assert map_digest(open_map(tmp_path / "m").snapshot) == new_digest
        assert len(list((tmp_path / "m/points").iterdir())) == 3
        shutil.rmtree(tmp_path / "m")
        step += 1
    assert status == 0
    assert step > 15
    assert found == sorted(found, key=[old_digest, new_digest].index)


@pytest.mark.parametrize("size", [0, 1, 100, 4096, 8_192])
def test_a_save_that_the_disk_refuses_leaves_the_old_map(old_and_new, size):
    old, old_digest, _ = old_and_new
    before = files_of(old)
    assert in_child(lambda: save_next(old), limit_file_size(size)) == 1
    assert map_digest(open_map(old).snapshot) == old_digest
    assert not [name for name in files_of(old) if name.endswith(".partial")]
    assert set(before) <= set(files_of(old))


def test_a_folder_that_cannot_be_created_leaves_nothing_behind(tmp_path):
    assert in_child(lambda: create(tmp_path / "a/b/m") and None, limit_file_size(10)) == 1
    assert list(tmp_path.iterdir()) == []


def test_a_creation_killed_at_any_step_can_be_replaced(old_and_new, tmp_path):
    old, old_digest, _ = old_and_new
    empty_digest = map_digest(replace(make_snapshot(), objects=()))
    status, step = 9, 0
    while status == 9:
        shutil.copytree(old, tmp_path / "m")
        status = in_child(lambda: create(tmp_path / "m", overwrite=True) and None, die_at(step))
        assert map_digest(open_map(tmp_path / "m").snapshot) in (old_digest, empty_digest)
        create(tmp_path / "m", overwrite=True)
        assert files_of(tmp_path / "m") == ["manifest.json"]
        shutil.rmtree(tmp_path / "m")
        step += 1
    assert status == 0
    assert step > 15


@pytest.mark.parametrize("overwrite", [False, True])
def test_foreign_files_are_named_and_never_touched(tmp_path, overwrite):
    create(tmp_path / "m")
    (tmp_path / "thesis.tex").write_text("years of work")
    (tmp_path / "objects.json").write_text("{}")
    (tmp_path / "m/notes.txt").write_text("mine")
    before = files_of(tmp_path)
    for path, named in (
        (tmp_path, r"objects\.json, thesis\.tex; choose another --out"),
        (tmp_path / "m", r"notes\.txt" if overwrite else r"holds a map already.*--out.*--overwrite"),
        (tmp_path / "thesis.tex", "is a file"),
        (tmp_path / "thesis.tex/m", "is a file"),
    ):
        with pytest.raises(MapFolderError, match=named):
            create(path, overwrite=overwrite)
    assert files_of(tmp_path) == before


def test_a_folder_without_permission_is_refused(tmp_path):
    if os.geteuid() == 0:
        pytest.skip("root may write everywhere")
    tmp_path.chmod(0o500)
    with pytest.raises(MapFolderError, match="no permission"):
        create(tmp_path / "m")


def test_a_folder_without_a_map_is_refused(tmp_path):
    with pytest.raises(MapFolderError, match="there is no map folder"):
        open_map(tmp_path / "absent")
    with pytest.raises(MapFolderError, match=r"holds no manifest\.json"):
        open_map(tmp_path)
    (tmp_path / "manifest.json").write_text('{"name": "web app"}')
    with pytest.raises(MapFolderError, match="another program"):
        open_map(tmp_path)


@pytest.mark.parametrize(("version", "remedy"), [(99, "newer hickory-stream"), (2, "play the log again"), (None, "")])
def test_another_format_is_refused_with_a_remedy(tmp_path, version, remedy):
    create(tmp_path / "m")
    manifest = json.loads((tmp_path / "m/manifest.json").read_text())
    (tmp_path / "m/manifest.json").write_text(json.dumps({**manifest, "format": version}))
    with pytest.raises(MapFolderError, match=f"format {version}, this version reads {FORMAT_VERSION}; .*{remedy}"):
        open_map(tmp_path / "m")


@pytest.mark.parametrize("victim", ["points", "space", "shapes", "objects.json", "manifest.json"])
@pytest.mark.parametrize("damage", ["missing", "cut", "changed"])
def test_a_missing_or_damaged_file_is_named(tmp_path, victim, damage):
    folder = create(tmp_path / "m")
    folder.save(make_snapshot(folder))
    folder.finish(finished_cleanly=True)
    place = tmp_path / "m" / victim
    path = place if place.is_file() else sorted(place.iterdir())[0]
    data = path.read_bytes()
    if damage == "missing":
        path.unlink()
    else:
        path.write_bytes(data[: len(data) // 2] if damage == "cut" else data[:-60] + bytes(b ^ 1 for b in data[-60:]))
    with pytest.raises(MapFolderError, match=path.name):
        saved = open_map(tmp_path / "m")
        for tracked in saved.snapshot.objects:
            assert len(tracked.points_world)
            if tracked.shape:
                saved.mesh(tracked.shape)
        assert all(len(submap.observed_space.free) for submap in saved.snapshot.submaps)
    if victim in ("points", "space"):
        with pytest.raises(MapFolderError, match=path.name):
            open_map(tmp_path / "m", is_whole=True)


def test_points_of_a_finished_map_are_read_on_use(tmp_path):
    folder = create(tmp_path / "m")
    saved = make_snapshot(folder)
    folder.save(saved)
    # Another process may go on writing: what is not read now may be gone by then.
    assert not any(has_given_up(tracked) for tracked in open_map(tmp_path / "m").snapshot.objects)
    folder.finish(finished_cleanly=True)
    opened = open_map(tmp_path / "m")
    assert opened.digest == map_digest(saved)
    assert all(has_given_up(tracked) for tracked in opened.snapshot.objects)
    assert map_digest(opened.snapshot) == map_digest(saved)
    with pytest.raises(ValueError, match="read-only"):
        opened.snapshot.objects[0].points_world[0] = 0


@pytest.mark.parametrize("change", ["digest", "objects.json", "no seal"])
def test_a_map_whose_seal_does_not_fit_is_read_as_a_whole(tmp_path, change):
    folder = create(tmp_path / "m")
    folder.save(make_snapshot(folder))
    manifest = folder.finish(finished_cleanly=True)
    if change == "objects.json":
        document = json.loads((tmp_path / "m/objects.json").read_text())
        document["objects"][0]["sightings"] += 1
        (tmp_path / "m/objects.json").write_text(json.dumps(document))
    else:
        altered = {"digest": "0" * 64} if change == "digest" else {"seal": ""}
        entries = json.loads((tmp_path / "m/manifest.json").read_text())
        (tmp_path / "m/manifest.json").write_text(json.dumps({**entries, **altered}))
    opened = open_map(tmp_path / "m", warns=False)
    assert not opened.is_sealed
    assert opened.is_altered == (change != "no seal")
    assert (opened.digest == manifest.digest) == (change != "objects.json")
