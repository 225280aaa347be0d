import json
import os
import shutil
from dataclasses import replace
import pytest
from hickory_stream.engine.shape_jobs.job_folder import write_job
from hickory_stream.errors import MapFolderError
from hickory_stream.events import RequestShape
from hickory_stream.journal.format import JOURNAL
from hickory_stream.map_folder.saved_map import open_map
from hickory_stream.map_folder.writer import create_map_folder, reopen_map_folder
from hickory_stream.shapes.build import ShapeConfig
from tests.cli.test_cli import refusal
from tests.engine.snapshot_fixtures import make_snapshot

OUTSIDE = "../../../../OUTSIDE"


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    path = tmp_path_factory.mktemp("sound") / "map"
    folder = create_map_folder(path, config={}, source={"uri": "desk.mcap", "identity": "x"})
    folder.save(make_snapshot(folder))
    folder.finish(finished_cleanly=True)
    folder.close()
    return path


@pytest.fixture
def path(sound, tmp_path):
    """A copy of the map, deep enough that `../../../../OUTSIDE` stays in the test's folder."""
    copy = tmp_path / "a/b/c/d/map"
    shutil.copytree(sound, copy)
    return copy


def change(path, changed):
    document = json.loads((path / "objects.json").read_text())
    changed(document)
    (path / "objects.json").write_text(json.dumps(document))


def everything(folder):
    return {str(f.relative_to(folder)): f.read_bytes() for f in folder.rglob("*") if f.is_file()}


CHANGES = {
    "id": lambda d: d["objects"][0].update(id=OUTSIDE), "id_true": lambda d: d["objects"][0].update(id=True),
    "id_twice": lambda d: d["objects"][1].update(id=d["objects"][0]["id"]),
    "submap_id": lambda d: d["submaps"][0].update(id=OUTSIDE),
    "points": lambda d: d["objects"][0].update(points=OUTSIDE),
    "points_absolute": lambda d: d["objects"][0].update(points="/etc/passwd"),
    "points_elsewhere": lambda d: d["objects"][0].update(points="space/../../../map2/points/000001-0.ply"),
    "free": lambda d: d["submaps"][0].update(free="../" + d["submaps"][0]["free"]),
    "mesh": lambda d: d["objects"][0]["shape"].update(mesh_name=OUTSIDE + ".glb"),
    "mesh_of_another_kind": lambda d: d["objects"][0]["shape"].update(mesh_name="000001.obj"),
    "view": lambda d: d["objects"][0]["views"][0].update(frame_index=OUTSIDE),
    "observation": lambda d: d["objects"][0]["views"][0].update(observation_index=OUTSIDE),
    "axes": lambda d: d["objects"][0]["shape"]["inflated"].update(semi_axes_m=[["inf", "inf", "inf"]]),
    "exponents": lambda d: d["objects"][0]["shape"]["inflated"].update(exponents=[[0.0, 0.0]]),
    "voxel": lambda d: d["submaps"][0].update(voxel_m=0), "stamp": lambda d: d.update(stamp_ns=10**30),
    "certified": lambda d: d["objects"][0]["shape"]["containment"].update(is_certified="yes"),
}  # fmt: skip


@pytest.mark.parametrize("name", CHANGES)
@pytest.mark.parametrize("command", [("inspect",), ("export", "--format", "mjcf"), ("export", "--format", "urdf")])
def test_a_map_with_forbidden_names_is_refused_in_one_line(path, tmp_path, command, name):
    change(path, CHANGES[name])
    before = everything(tmp_path)
    where = ("-o", path.parent / "out/deep/scene") if command[0] == "export" else ()
    (told,) = refusal(command[0], path, *command[1:], *where).splitlines()
    assert "is damaged" in told
    assert everything(tmp_path) == before


@pytest.mark.parametrize("name", ["objects.json", "manifest.json", "views", "shapes", "points", JOURNAL])
def test_a_map_of_which_a_part_is_a_link_out_of_it_is_refused(path, tmp_path, name):
    moved = tmp_path / "elsewhere"
    if (path / name).exists():
        (path / name).rename(moved)
    (path / name).symlink_to(moved)
    with pytest.raises(MapFolderError, match=r"is a link"):
        open_map(path)


def test_linked_meshes_and_views_outside_the_map_are_not_read(path, tmp_path):
    from hickory_stream.map_folder.views import read_crop

    saved = open_map(path)
    first = saved.snapshot.objects[0]
    for file in (saved.mesh_path(first.shape), saved.views / f"{first.views[0].name}.view"):
        file.rename(tmp_path / file.name)
        file.symlink_to(tmp_path / file.name)
    with pytest.raises(MapFolderError, match="leads out of"):
        saved.mesh(first.shape)
    with pytest.raises(MapFolderError, match="leads out of"):
        read_crop(saved.views, first.views[0].name)


def test_a_view_linked_out_of_the_map_reaches_no_worker(path, tmp_path):
    tracked = open_map(path).snapshot.objects[0]
    view = path / f"views/{tracked.views[0].name}.view"
    view.rename(tmp_path / "elsewhere.png")
    view.symlink_to(tmp_path / "elsewhere.png")
    request = RequestShape(
        ticket=1, object_id=tracked.id, views=tracked.views, points_world=tracked.points_world, colors=tracked.colors,
        box=tracked.box, support_z_m=None, due_ns=0,
    )  # fmt: skip
    with pytest.raises(MapFolderError, match="leads out of"):
        write_job(path / "jobs/000001", request, path / "views", ShapeConfig())
    folder = reopen_map_folder(path)
    with pytest.raises(MapFolderError, match="it is a link, which is not followed"):
        folder.save(replace(make_snapshot(), revision=7))
    folder.close()


@pytest.mark.timeout(20)
@pytest.mark.parametrize("name", ["manifest.json", "objects.json", "ledger.json", JOURNAL])
def test_a_pipe_in_place_of_a_file_is_refused_without_waiting(path, name):
    (path / name).unlink(missing_ok=True)
    os.mkfifo(path / name)
    with pytest.raises(MapFolderError):
        open_map(path).as_known_at(0)


@pytest.mark.parametrize("name", [".lock", ".objects.json.partial", ".journal.mcap.partial", "jobs", "views"])
def test_what_a_resumed_run_writes_never_goes_through_a_link(path, tmp_path, name):
    precious = tmp_path / "precious"
    precious.write_text("years of work")
    shutil.rmtree(path / name, ignore_errors=True)
    (path / name).symlink_to(precious if name.startswith(".") else tmp_path)
    before = everything(tmp_path)
    try:
        folder = reopen_map_folder(path)
        folder.save(replace(make_snapshot(), revision=7))
        folder.close()
    except MapFolderError as error:
        assert "link" in str(error)
        assert everything(tmp_path) == before
    assert precious.read_text() == "years of work"


def test_json_that_is_too_deep_for_its_reader_is_damage(path):
    (path / "objects.json").write_text("[" * 100_000)
    with pytest.raises(MapFolderError, match="is damaged"):
        open_map(path)


def test_a_killed_resumed_run_has_no_digest_of_another_map(path):
    folder = reopen_map_folder(path)
    folder.save(replace(make_snapshot(), objects=()))
    folder.close()
    saved = open_map(path)
    assert (saved.snapshot.objects, saved.manifest.digest, saved.manifest.finished_cleanly) == ((), None, False)
