import json
import shutil
import pytest
from mcap.reader import make_reader
from hickory_stream.box_scene import SceneSource
from hickory_stream.engine.mapper import MapperConfig
from hickory_stream.errors import MapFolderError, RecordingError
from hickory_stream.journal.format import JOURNAL
from hickory_stream.journal.reader import Journal
from hickory_stream.map_folder.digest import map_digest
from hickory_stream.map_folder.history.replay import replay
from hickory_stream.map_folder.history.resume import reopen
from hickory_stream.map_folder.saved_map import open_map
from hickory_stream.map_folder.writer import create_map_folder
from hickory_stream.testing import BreakingSource
from tests.engine.run_fixtures import NUM_FRAMES, map_scene, resume_scene, stop_at


def resume(path, source=None):
    return resume_scene(path, source or SceneSource(NUM_FRAMES))


def test_the_journal_is_a_whole_mcap_file_that_gives_the_map(undisturbed_run):
    assert map_digest(replay(undisturbed_run.folder.path)) == undisturbed_run.digest
    with (undisturbed_run.folder.path / JOURNAL).open("rb") as file:
        summary = make_reader(file, validate_crcs=True).get_summary()
    topics = {channel.topic: number for number, channel in summary.channels.items()}
    counts = summary.statistics.channel_message_counts
    assert counts[topics["event/FrameObserved"]] == NUM_FRAMES
    assert counts[topics["event/SourceEnded"]] == 1
    assert counts[topics["event/ShapeReady"]] >= 3


@pytest.mark.parametrize("keyframes", [1, 4, 7])
def test_a_run_that_was_stopped_goes_on_to_the_same_map(undisturbed_run, tmp_path, keyframes):
    # With patience for what runs: its shapes come ahead of their time, and must not stay.
    stopped = map_scene(tmp_path, "run.grace_s=20.0", on_progress=stop_at(keyframes))
    assert not stopped.folder.manifest.finished_cleanly
    assert resume(tmp_path / "map") == undisturbed_run.digest
    saved = open_map(tmp_path / "map")
    assert saved.manifest.finished_cleanly
    assert saved.ledger == json.loads((undisturbed_run.folder.path / "ledger.json").read_text())
    assert map_digest(replay(tmp_path / "map")) == undisturbed_run.digest
    assert not (tmp_path / "map/jobs").exists()


@pytest.mark.parametrize("whole_frames", [0, 5])
def test_a_run_whose_source_broke_goes_on_when_it_is_whole_again(undisturbed_run, tmp_path, whole_frames):
    with pytest.raises(RecordingError, match="torn"):
        map_scene(tmp_path, source=BreakingSource(SceneSource(NUM_FRAMES), whole_frames, RecordingError("torn")))
    with Journal(tmp_path / "map") as journal:
        assert (len(journal) > 0) == (whole_frames > 0)
    assert resume(tmp_path / "map") == undisturbed_run.digest


@pytest.mark.parametrize("share", [0.0, 0.01, 0.3, 0.6, 0.97])
def test_a_cut_journal_resumes_at_its_last_whole_step(undisturbed_run, tmp_path, share):
    folder = tmp_path / "map"
    shutil.copytree(undisturbed_run.folder.path, folder)
    journal = folder / JOURNAL
    journal.write_bytes(journal.read_bytes()[: int(share * journal.stat().st_size)])
    manifest = json.loads((folder / "manifest.json").read_text())
    (folder / "manifest.json").write_text(json.dumps({**manifest, "finished_cleanly": False}))
    try:
        assert resume(folder) == undisturbed_run.digest
    except MapFolderError as error:
        # The run had ended, and what its steps of long ago waited for was cleared away: that is said, nothing is lost.
        assert "did not reach the disk" in str(error) or "lacks views" in str(error)
        assert open_map(folder).snapshot.objects


def test_a_finished_map_a_live_map_and_another_log_are_refused(undisturbed_run, tmp_path):
    with pytest.raises(MapFolderError, match="is finished: there is nothing to resume"):
        resume(undisturbed_run.folder.path)
    map_scene(tmp_path, on_progress=stop_at(2))
    with pytest.raises(RecordingError, match="is not the log that"):
        resume(tmp_path / "map", SceneSource(NUM_FRAMES + 1))
    manifest = json.loads((tmp_path / "map/manifest.json").read_text())
    (tmp_path / "map/manifest.json").write_text(json.dumps({**manifest, "run": {"mode": "live", "loops": 1}}))
    with pytest.raises(MapFolderError, match="live run, whose frames are gone"):
        resume(tmp_path / "map")


@pytest.mark.parametrize("is_over_another", [False, True])
def test_a_run_killed_with_an_empty_folder_starts_over(undisturbed_run, tmp_path, *, is_over_another):
    folder, manifest = tmp_path / "map", undisturbed_run.folder.manifest
    if is_over_another:
        shutil.copytree(undisturbed_run.folder.path, folder)
    made = create_map_folder(
        folder, config=manifest.config, source=manifest.source, run=manifest.run, extractor=manifest.extractor,
        overwrite=is_over_another,
    )  # fmt: skip
    made.close()
    assert resume(folder) == undisturbed_run.digest


def test_a_map_with_features_of_another_extractor_is_refused(tmp_path):
    source = SceneSource(NUM_FRAMES)
    noted, run = {"identity": source.info.identity, "uri": "scene"}, {"mode": "playback", "loops": 1}
    create_map_folder(tmp_path / "m", config={}, source=noted, run=run, extractor="dinov2").close()
    assert open_map(tmp_path / "m").manifest.extractor == "dinov2"
    with pytest.raises(MapFolderError, match="features of dinov2, not of mean-color"):
        reopen(tmp_path / "m", source.info, MapperConfig(), "mean-color")
