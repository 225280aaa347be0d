import json
import shutil
import pytest
from hickory_stream.errors import MapFolderError
from hickory_stream.journal.format import JOURNAL
from hickory_stream.map_folder.digest import map_digest
from hickory_stream.map_folder.saved_map import open_map
from hickory_stream.map_folder.verify import State, mend, verify
from tests.cli.test_cli import answer, look, refusal, said


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


def test_a_shrunk_layer_four_is_nowhere_certified_or_exported(path, tmp_path):
    changed = shrink_layer_four(path)
    verdict = verify(path)
    assert not verdict.is_sound
    assert [f.object_id for f in verdict.findings if f.check == "layer 4" and f.state is State.FAILS] == [changed]

    told = said("inspect", path)
    assert "layer 4: NOT PROVEN" in told and "certified" not in told
    summary = answer("inspect", path)
    assert (summary["is_altered"], summary["num_certified"]) == (True, 0)
    assert not any(row["containment"]["is_certified"] for row in summary["objects"] if row["containment"])

    other = shutil.copytree(path, tmp_path / "other")
    plan = ("plan", path, "--start", "0,-1.5", "--goal", "0,-1.4", "--robot", "point")
    export = ("export", path, "-o", tmp_path / "x.json")
    for refused in (plan, export, ("merge", path, other, "-o", tmp_path / "both")):
        (error,) = refusal(*refused).splitlines()
        assert "hickory-stream verify" in error
    assert not (tmp_path / "x.json").exists()
    assert "note: layer 4 is not proven" in look(*plan, "--allow-unverified", "--unknown", "free").stdout
    said(*export, "--allow-unverified")
    assert (tmp_path / "x.json").exists()

    assert "the same map" not in said("replay", path, status=1)
    replayed = answer("replay", path, status=1)
    assert replayed["is_same"] is False
    assert replayed["digest"] == replayed["recorded_digest"] != replayed["saved_digest"]


def test_a_recomputed_digest_hides_nothing_and_none_is_missed(path):
    changed = shrink_layer_four(path)
    compute_digest_anew(path)
    assert not open_map(path).is_altered
    verdict = verify(path)
    assert states(verdict, "digest") == {State.HOLDS}
    assert states(verdict, "journal") == {State.FAILS}
    assert [f.object_id for f in verdict.findings if f.check == "layer 4" and f.state is State.FAILS] == [changed]
    change(path / "manifest.json", lambda manifest: manifest.update(digest=None))
    saved = open_map(path)
    assert saved.is_altered
    assert "its manifest has none" in saved.doubt


def test_a_margin_that_was_taken_away_is_found(path):
    def without_margin(document):
        for tracked in document["objects"]:
            if tracked["shape"] is not None:
                tracked["shape"]["containment"]["margin_m"] = 0.0

    change(path / "objects.json", without_margin)
    compute_digest_anew(path)
    failed = [finding for finding in verify(path).findings if finding.check == "layer 4"]
    assert all(f.state is State.FAILS and "its margin is 0 m" in f.text for f in failed)


@pytest.mark.parametrize("kind", ["mesh", "view", "journal"])
def test_a_file_that_was_changed_is_named(path, kind):
    saved = open_map(path)
    tracked = next(o for o in saved.snapshot.objects if o.shape is not None)
    if kind == "mesh":
        other = next(o.shape for o in saved.snapshot.objects if o.shape is not None and o.id != tracked.id)
        shutil.copy(saved.mesh_path(other), saved.mesh_path(tracked.shape))
        named = "is not the mesh"
    elif kind == "view":
        file = saved.views / f"{tracked.views[0].name}.view"
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


def test_the_command_exits_0_1_and_2(path):
    assert "sound; layer 4 of" in said("verify", path).splitlines()[-1]
    shrink_layer_four(path)
    found = answer("verify", path, status=1)
    assert found["is_sound"] is False
    assert {finding["state"] for finding in found["findings"]} == {"holds", "fails"}
    (path / "objects.json").write_text("{")
    assert len(refusal("verify", path).splitlines()) == 1


@pytest.mark.parametrize("damage", ["altered", "unreadable"])
def test_a_map_is_mended_from_its_journal_only_when_asked(path, undisturbed_run, damage):
    before = sorted(file.relative_to(path) for file in path.rglob("*") if file.is_file())
    if damage == "altered":
        shrink_layer_four(path)
    else:
        (path / "objects.json").write_text("{")
    assert look("verify", path).status in (1, 2)
    said("verify", path, "--repair")
    saved = open_map(path)
    assert not saved.is_altered
    assert saved.manifest.finished_cleanly
    assert saved.digest == undisturbed_run.digest
    assert sorted(file.relative_to(path) for file in path.rglob("*") if file.is_file()) == before


def test_what_the_journal_does_not_bear_out_is_not_mended(path):
    shrink_layer_four(path)
    change(path / "manifest.json", lambda manifest: manifest.update(digest="0" * 64))
    before = (path / "objects.json").read_bytes()
    assert "cannot be mended" in refusal("verify", path, "--repair")
    assert (path / "objects.json").read_bytes() == before
    (path / JOURNAL).unlink()
    with pytest.raises(MapFolderError):
        mend(path)
