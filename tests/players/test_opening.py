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


def test_an_unknown_file_or_folder_is_told_with_what_is_in_it(tmp_path):
    (tmp_path / "desk.mcap").write_bytes(b"%PDF-1.4 and so on")
    with pytest.raises(RecordingError, match=r"of no known kind \(it begins with 25 50 44 46"):
        open_source(tmp_path / "desk.mcap")
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "notes.txt").touch()
    with pytest.raises(RecordingError, match=r"no log that is known: found 1 \.txt \(such as notes\.txt\); expected"):
        open_source(tmp_path / "folder")


def test_a_folder_is_its_only_log_or_asks_which(tmp_path):
    # The kind is told by the bytes and not by the extension; a URI may be text.
    log = _mcap(tmp_path / "a.bag")
    source = open_source(str(tmp_path))
    assert (source.info.uri, source.info.kind, source.info.num_frames) == (str(log), "MCAP", scenes.NUM_FRAMES)
    _mcap(tmp_path / "b.mcap")
    with pytest.raises(RecordingError, match=r"holds 2 logs without a metadata\.yaml.*to play: a\.bag, b\.mcap"):
        open_source(tmp_path)


def test_a_folder_with_the_parts_of_a_split_recording_is_one_log(tmp_path):
    m = scenes.Messages(ros=2)
    messages = scenes.scene_messages(m, scenes.make_scene(), scenes.png_images)
    half = len(messages) // 2
    scenes.write_mcap(tmp_path / "run_0.mcap", m, messages[:half])
    scenes.write_mcap(tmp_path / "run_1.mcap", m, messages[half:])
    assert len(list(open_source(tmp_path).frames())) == scenes.NUM_FRAMES


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


@pytest.mark.parametrize("share", [0.0, 0.5, 0.95])
def test_a_bag_that_was_cut_off_is_played_as_far_as_it_goes(tmp_path, share):
    m = scenes.Messages(ros=1)
    bag = scenes.write_ros1(tmp_path / "a.bag", m, scenes.scene_messages(m, scenes.make_scene(), scenes.raw_images))
    bag.write_bytes(bag.read_bytes()[: max(2000, int(share * bag.stat().st_size))])
    if share:
        assert 0 < len(list(open_source(bag).frames())) < scenes.NUM_FRAMES
    else:
        with pytest.raises(RecordingError, match=r"a\.bag is cut off or damaged, and no connection"):
            open_source(bag)


@pytest.mark.parametrize(
    ("parts", "heavy"),
    [
        ("players", "rosbags mcap cv2"),
        ("hickory_stream.engine.mapper, players.doctor.motion_mends", "scipy.spatial scipy.ndimage scipy.special"),
    ],
)
def test_importing_loads_no_special_parts(parts, heavy):
    code = f"import sys, {parts}; sys.exit(str(found) if (found := set('{heavy}'.split()) & set(sys.modules)) else 0)"
    subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True, timeout=15)
