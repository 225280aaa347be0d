import json
import shutil
import pytest
from hickory_stream.cli import main
from hickory_stream.errors import MapFolderError
from hickory_stream.journal.format import JOURNAL
from hickory_stream.map_folder.digest import map_digest
from hickory_stream.map_folder.saved_map import open_map
from hickory_stream.map_folder.verify import State, verify


@pytest.fixture
def path(undisturbed_run, tmp_path):
    shutil.copytree(undisturbed_run.folder.path, tmp_path / "map")
    return tmp_path / "map"


def change(file, changed):
    document = json.loads(file.read_text())
    changed(document)
    file.write_text(json.dumps(document))


def shrink_layer_four(path):
    """Make layer 4 of the first object that has one a millimetre wide; return its id."""
    ids = []

    def shrink(document):
        tracked = next(o for o in document["objects"] if o["shape"] is not None)
        inflated = tracked["shape"]["inflated"]
        inflated["semi_axes_m"] = [[0.001] * 3 for _ in inflated["semi_axes_m"]]
        ids.append(tracked["id"])

    change(path / "objects.json", shrink)
    return int(ids[0])


def compute_digest_anew(path):
    digest = map_digest(open_map(path).snapshot)
    change(path / "manifest.json", lambda manifest: manifest.update(digest=digest))


def states(verdict, check):
    return {finding.state for finding in verdict.findings if finding.check == check}


def call(capsys, *arguments):
    capsys.readouterr()
    return main([str(argument) for argument in arguments]), *capsys.readouterr()


def test_a_sound_map_is_proven_and_not_a_byte_of_it_changes(path):
    before = {file: file.read_bytes() for file in path.rglob("*") if file.is_file()}
    verdict = verify(path)
    assert verdict.is_sound
    assert {f.state for f in verdict.findings} == {State.HOLDS}
    shaped = [tracked for tracked in open_map(path).snapshot.objects if tracked.shape is not None]
    assert verdict.num_proven == len(shaped) >= 3
    assert {file: file.read_bytes() for file in path.rglob("*") if file.is_file()} == before


def test_the_journal_of_a_killed_run_proves_the_map(path):
    change(path / "manifest.json", lambda manifest: manifest.update(finished_cleanly=False, digest=None))
    verdict = verify(path)
    assert verdict.is_sound
    assert states(verdict, "digest") == {State.UNKNOWN}
    assert states(verdict, "journal") == {State.HOLDS}
    shrink_layer_four(path)
    verdict = verify(path)
    assert not verdict.is_sound
    assert states(verdict, "journal") == {State.FAILS}


def test_a_merged_maps_layer_four_is_proven_from_its_meshes(path):
    (path / JOURNAL).unlink()
    assert not verify(path).is_sound
    change(path / "manifest.json", lambda manifest: manifest["source"].update(kind="merge"))
    verdict = verify(path)
    assert verdict.is_sound
    assert states(verdict, "journal") == {State.UNKNOWN}
    assert verdict.num_proven >= 3
    changed = shrink_layer_four(path)
    compute_digest_anew(path)
    assert [f.object_id for f in verify(path).findings if f.state is State.FAILS] == [changed]


def test_a_shrunk_layer_four_is_nowhere_certified_or_exported(path, tmp_path, capsys):
    changed = shrink_layer_four(path)
    verdict = verify(path)
    assert not verdict.is_sound
    assert [f.object_id for f in verdict.findings if f.check == "layer 4" and f.state is State.FAILS] == [changed]

    status, told, _ = call(capsys, "inspect", path)
    assert status == 0
    assert "layer 4: NOT PROVEN" in told
    assert "certified" not in told
    summary = json.loads(call(capsys, "inspect", path, "--json")[1])
    assert (summary["is_altered"], summary["num_certified"]) == (True, 0)
    assert not any(row["containment"]["is_certified"] for row in summary["objects"] if row["containment"])

    other = shutil.copytree(path, tmp_path / "other")
    plan = ("plan", path, "--start", "0,-1.5", "--goal", "0,-1.4", "--robot", "point")
    for refused in (plan, ("export", path, "-o", tmp_path / "x.json"), ("merge", path, other, "-o", tmp_path / "both")):
        status, told, error = call(capsys, *refused)
        assert (status, told) == (2, "")
        assert len(error.splitlines()) == 1
        assert "hickory-stream verify" in error
    assert not (tmp_path / "x.json").exists()
    assert "note: layer 4 is not proven" in call(capsys, *plan, "--allow-unverified", "--unknown", "free")[1]
    assert call(capsys, "export", path, "-o", tmp_path / "x.json", "--allow-unverified")[0] == 0
    assert (tmp_path / "x.json").exists()

    status, told, _ = call(capsys, "replay", path)
    assert status == 1
    assert "the same map" not in told
    answer = json.loads(call(capsys, "replay", path, "--json")[1])
    assert answer["is_same"] is False
    assert answer["digest"] == answer["recorded_digest"] != answer["saved_digest"]


def test_a_recomputed_digest_hides_nothing_from_verify(path):
    changed = shrink_layer_four(path)
    compute_digest_anew(path)
    assert not open_map(path).is_altered
    verdict = verify(path)
    assert states(verdict, "digest") == {State.HOLDS}
    assert states(verdict, "journal") == {State.FAILS}
    assert [f.object_id for f in verdict.findings if f.check == "layer 4" and f.state is State.FAILS] == [changed]


def test_a_margin_that_was_taken_away_is_found(path):
    def without_margin(document):
        for tracked in document["objects"]:
            if tracked["shape"] is not None:
                tracked["shape"]["containment"]["margin_m"] = 0.0

    change(path / "objects.json", without_margin)
    compute_digest_anew(path)
    failed = [finding for finding in verify(path).findings if finding.check == "layer 4"]
    assert all(f.state is State.FAILS and "its margin is 0 m" in f.text for f in failed)


def test_a_digest_that_was_taken_out_of_a_finished_map_is_missed(path):
    change(path / "manifest.json", lambda manifest: manifest.update(digest=None))
    saved = open_map(path)
    assert saved.is_altered
    assert "its manifest has none" in saved.doubt


@pytest.mark.parametrize("kind", ["mesh", "view", "journal"])
def test_a_file_that_was_changed_is_named(path, kind):
    saved = open_map(path)
    tracked = next(o for o in saved.snapshot.objects if o.shape is not None)
    if kind == "mesh":
        other = next(o.shape for o in saved.snapshot.objects if o.shape is not None and o.id != tracked.id)
        shutil.copy(saved.mesh_path(other), saved.mesh_path(tracked.shape))
        named = "is not the mesh"
    elif kind == "view":
        file = saved.views / f"{tracked.views[0].name}.depth.png"
        file.write_bytes(file.read_bytes()[:-20])
        named = file.name
    else:
        data = bytearray((path / JOURNAL).read_bytes())
        data[len(data) // 2] ^= 0xFF
        (path / JOURNAL).write_bytes(data)
        named = JOURNAL
    failed = [finding.text for finding in verify(path).findings if finding.state is State.FAILS]
    assert failed
    assert any(named in text or "another map" in text for text in failed)


def test_the_command_exits_0_1_and_2(path, capsys):
    status, told, _ = call(capsys, "verify", path)
    assert status == 0
    assert "sound; layer 4 of" in told.splitlines()[-1]
    shrink_layer_four(path)
    status, told, _ = call(capsys, "verify", path, "--json")
    assert status == 1
    answer = json.loads(told)
    assert answer["is_sound"] is False
    assert {finding["state"] for finding in answer["findings"]} == {"holds", "fails"}
    (path / "objects.json").write_text("{")
    status, told, error = call(capsys, "verify", path)
    assert (status, told) == (2, "")
    assert len(error.splitlines()) == 1


@pytest.mark.parametrize("damage", ["altered", "unreadable"])
def test_a_map_is_mended_from_its_journal_only_when_asked(path, undisturbed_run, capsys, damage):
    before = sorted(file.relative_to(path) for file in path.rglob("*") if file.is_file())
    if damage == "altered":
        shrink_layer_four(path)
    else:
        (path / "objects.json").write_text("{")
    assert call(capsys, "verify", path)[0] in (1, 2)
    assert call(capsys, "verify", path, "--repair")[0] == 0
    saved = open_map(path)
    assert not saved.is_altered
    assert saved.manifest.finished_cleanly
    assert saved.digest == undisturbed_run.digest
    assert sorted(file.relative_to(path) for file in path.rglob("*") if file.is_file()) == before


def test_what_the_journal_does_not_bear_out_is_not_mended(path, capsys):
    shrink_layer_four(path)
    change(path / "manifest.json", lambda manifest: manifest.update(digest="0" * 64))
    before = (path / "objects.json").read_bytes()
    status, _, error = call(capsys, "verify", path, "--repair")
    assert status == 2
    assert "cannot be mended" in error
    assert (path / "objects.json").read_bytes() == before
    with pytest.raises(MapFolderError):
        (path / JOURNAL).unlink()
        from hickory_stream.map_folder.verify import mend

        mend(path)
