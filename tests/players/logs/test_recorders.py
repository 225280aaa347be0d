import pytest
import zstandard
from hickory_stream.errors import InputError
from players import SourceOptions, open_source
from players.doctor.diagnosis import SOUND, examine
from players.logs.mcap_log import McapLog
from tests import player_scenes as scenes

M = scenes.Messages(ros=2)
LOG = scenes.scene_messages(M, scenes.make_scene(num_frames=12), scenes.png_images)


def _frames(path):
    frames = [raw.decode() for raw in open_source(path).frames()]
    return [(f.stamp_ns, f.rgb.tobytes(), f.depth_m.tobytes(), f.world_from_camera.tobytes()) for f in frames]


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    frames = _frames(scenes.write_mcap(tmp_path_factory.mktemp("sound") / "log.mcap", M, LOG))
    assert len(frames) == 12
    return frames


@pytest.mark.parametrize("settings", [{}, {"use_chunking": False}])
@pytest.mark.parametrize("level", [1, 19])
def test_messages_packed_one_by_one_play_as_plain_ones(tmp_path, sound, settings, level):
    packed = scenes.write_mcap(tmp_path / "log.mcap", M, LOG, pack=zstandard.ZstdCompressor(level).compress, **settings)
    assert _frames(packed) == sound
    assert examine([packed], SourceOptions()).status == SOUND


@pytest.mark.parametrize("settings", [{}, {"use_chunking": False}])
def test_a_packed_message_that_is_damaged_is_counted(tmp_path, settings):
    numbers = iter(range(len(LOG)))

    def pack(data):
        packed = zstandard.compress(data)
        return packed[:-9] if next(numbers) in (9, 10, 11) else packed

    log = McapLog(scenes.write_mcap(tmp_path / "log.mcap", M, LOG, pack=pack, **settings))
    read = sum(1 for _ in log.messages({topic.name for topic in log.topics}))
    assert (read, sum(log.flaws.lost().values())) == (len(LOG) - 3, 3)


def _dds_type(name):
    package, _, last = name.split("/")
    return f"{package}::msg::dds_::{last}_"


def test_names_and_types_of_dds_are_those_of_ros(tmp_path, sound):
    idl = "module sensor_msgs { module msg { module dds_ { struct Any_ { long x; }; }; }; };"
    names = {"topic": "rt{}".format, "type_name": _dds_type}
    log = scenes.write_mcap(tmp_path / "log.mcap", M, LOG, encoding="omgidl", definition=lambda _: idl, **names)
    assert _frames(log) == sound
    assert open_source(log, SourceOptions(color_topic=f"rt{scenes.PNG_COLOR}")).info.num_frames == 12


@pytest.mark.parametrize("keep", [0, 1])
def test_ros_1_definitions_that_are_left_out_are_its_own(tmp_path, monkeypatch, keep):
    m = scenes.Messages(ros=1)
    whole = m.store.generate_msgdef

    def cut(name, **settings):
        text, md5 = whole(name, **settings)
        return "".join(text.split("=" * 80)[:keep]), md5

    messages = scenes.scene_messages(m, scenes.make_scene(), scenes.png_images)
    expected = _frames(scenes.write_ros1(tmp_path / "whole.bag", m, messages))
    monkeypatch.setattr(m.store, "generate_msgdef", cut)
    assert _frames(scenes.write_ros1(tmp_path / "cut.bag", m, messages)) == expected


@pytest.mark.parametrize(
    ("name", "definition", "reason"),
    [("/cam/color", "uint8 a\nstring b", "Invalid string length"), ("/odom", "((", "Could not parse")],
)
def test_the_reason_why_messages_cannot_be_read_is_said(tmp_path, name, definition, reason):
    path = scenes.write_mcap(
        tmp_path / "log.mcap", M, LOG, definition=lambda m: definition if m.topic.startswith(name) else ""
    )
    with pytest.raises(InputError, match=rf"messages.*cannot be read.*{reason}"):
        open_source(path)


def test_a_file_that_metadata_does_not_list_is_a_note(tmp_path, sound):
    bag = scenes.write_ros2(tmp_path / "bag", M, LOG, storage="mcap")
    (bag / "notes.db3").write_bytes(b"no database")
    scenes.write_mcap(bag / "other.mcap", M, LOG)
    found = examine([bag], SourceOptions())
    assert (found.status, found.problems) == (SOUND, [])
    left_out = [note for note in found.notes if "is not in metadata.yaml and was left out" in note]
    assert [note.split()[0] for note in left_out] == ["notes.db3", "other.mcap"]
    assert _frames(bag) == sound


def test_the_last_file_of_a_recorder_that_was_killed_is_played(tmp_path, sound):
    bag = scenes.write_ros2(tmp_path / "bag", M, LOG[: len(LOG) // 2], storage="mcap")
    (listed,) = bag.glob("*.mcap")
    text = (bag / "metadata.yaml").read_text().replace(listed.name, "bag_0.mcap")
    (bag / "metadata.yaml").write_text(text)
    listed.rename(bag / "bag_0.mcap")
    scenes.write_mcap(bag / "bag_1.mcap", M, LOG[len(LOG) // 2 :])
    assert _frames(bag) == sound
