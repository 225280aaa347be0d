import subprocess
import sys
from pathlib import Path
import pytest
from hickory_stream.errors import RecordingError
from players import open_source
from tests import player_scenes as scenes

ROOT = Path(__file__).resolve().parents[2]


def _mcap(path):
    m = scenes.Messages(ros=2)
    return scenes.write_mcap(path, m, scenes.scene_messages(m, scenes.make_scene(), scenes.png_images))


def test_a_file_of_another_kind_is_told_with_its_first_bytes(tmp_path):
    (tmp_path / "desk.mcap").write_bytes(b"%PDF-1.4 and so on")
    with pytest.raises(RecordingError, match=r"of no known kind \(it begins with 25 50 44 46"):
        open_source(tmp_path / "desk.mcap")


def test_an_unknown_folder_layout_is_refused_with_its_contents(tmp_path):
    (tmp_path / "notes.txt").touch()
    with pytest.raises(RecordingError, match=r"no log that is known: found 1 \.txt \(such as notes\.txt\); expected"):
        open_source(tmp_path)


def test_a_folder_with_one_log_in_it_is_that_log(tmp_path):
    _mcap(tmp_path / "a.mcap")
    assert open_source(tmp_path).info.uri == str(tmp_path / "a.mcap")


def test_a_folder_with_several_logs_asks_which(tmp_path):
    _mcap(tmp_path / "a.mcap")
    _mcap(tmp_path / "b.mcap")
    with pytest.raises(RecordingError, match=r"holds 2 logs without a metadata\.yaml.*to play: a\.mcap, b\.mcap"):
        open_source(tmp_path)


def test_a_folder_with_the_parts_of_a_split_recording_is_one_log(tmp_path):
    m = scenes.Messages(ros=2)
    messages = scenes.scene_messages(m, scenes.make_scene(), scenes.png_images)
    half = len(messages) // 2
    scenes.write_mcap(tmp_path / "run_0.mcap", m, messages[:half])
    scenes.write_mcap(tmp_path / "run_1.mcap", m, messages[half:])
    assert len(list(open_source(tmp_path).frames())) == scenes.NUM_FRAMES


def test_the_kind_is_told_by_the_bytes_and_not_by_the_extension(tmp_path):
    assert open_source(_mcap(tmp_path / "recording.bag")).info.kind == "MCAP"


def test_a_uri_may_be_text(tmp_path):
    assert open_source(str(_mcap(tmp_path / "a.mcap"))).info.num_frames == scenes.NUM_FRAMES


@pytest.mark.parametrize("share", [0.001, 0.1, 0.5])
def test_a_log_cut_in_its_first_chunk_is_refused(tmp_path, share):
    log = _mcap(tmp_path / "a.mcap")
    log.write_bytes(log.read_bytes()[: max(20, int(share * log.stat().st_size))])
    with pytest.raises(RecordingError, match=r"a\.mcap is cut off.*at least one whole chunk"):
        open_source(log)


@pytest.mark.parametrize("missing", [1, 100, 1000])
def test_a_log_without_its_end_is_played_whole(tmp_path, missing):
    log = _mcap(tmp_path / "a.mcap")
    log.write_bytes(log.read_bytes()[:-missing])
    assert len(list(open_source(log).frames())) == scenes.NUM_FRAMES


@pytest.mark.parametrize("share", [0.5, 0.95])
def test_a_bag_that_was_cut_off_is_played_as_far_as_it_goes(tmp_path, share):
    m = scenes.Messages(ros=1)
    bag = scenes.write_ros1(tmp_path / "a.bag", m, scenes.scene_messages(m, scenes.make_scene(), scenes.raw_images))
    bag.write_bytes(bag.read_bytes()[: int(share * bag.stat().st_size)])
    assert 0 < len(list(open_source(bag).frames())) < scenes.NUM_FRAMES


def test_a_bag_that_was_cut_off_at_once_is_told(tmp_path):
    m = scenes.Messages(ros=1)
    bag = scenes.write_ros1(tmp_path / "a.bag", m, scenes.scene_messages(m, scenes.make_scene(), scenes.raw_images))
    bag.write_bytes(bag.read_bytes()[:2000])
    with pytest.raises(RecordingError, match=r"a\.bag is cut off or damaged, and no connection"):
        open_source(bag)


def test_importing_the_players_loads_no_special_parts():
    heavy = "{'rosbags', 'mcap', 'cv2'} & set(sys.modules)"
    code = f"import sys, players; sys.exit(str({heavy}) if {heavy} else 0)"
    subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True, timeout=15)
