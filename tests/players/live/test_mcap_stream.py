import os
import sys
from threading import Thread
import pytest
from hickory_stream.errors import RecordingError
from players.live import open_live
from players.live.routes import is_live
from players.opening import open_source
from tests.player_scenes import NUM_FRAMES
from tests.players.live.robot_fixtures import scene_log


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    return scene_log(tmp_path_factory.mktemp("stream") / "scene.mcap", chunk_size=4000)


def write_in_thread(path, data):
    def write():
        with path.open("wb") as stream:
            for at in range(0, len(data), 999):
                stream.write(data[at : at + 999])
                stream.flush()

    thread = Thread(target=write, daemon=True)
    thread.start()
    return thread


def test_a_pipe_is_mapped_until_its_writer_ends(log, tmp_path):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    writer = write_in_thread(pipe, log.read_bytes())
    source = open_live(f"mcap:{pipe}", attempt_s=0.3)
    stamps = [frame.stamp_ns for frame in source.frames()]
    writer.join(5.0)
    assert stamps == [frame.stamp_ns for frame in open_source(log).frames()]
    account = source.account().as_dict()
    assert account["difference"] == 0
    assert account["declared"] == sum(topic.num_messages or 0 for topic in open_source(log)._log.topics)
    source.close()


def test_a_file_that_grows_is_followed_beyond_its_end(log, tmp_path):
    data = log.read_bytes()
    path = tmp_path / "growing.mcap"
    path.write_bytes(data[: len(data) // 2])
    source = open_live(f"mcap:{path}", attempt_s=0.3)
    frames = source.frames()
    seen = [next(frames)]
    with path.open("ab") as stream:
        stream.write(data[len(data) // 2 :])
    seen += list(frames)
    assert len(seen) == NUM_FRAMES
    source.close()


def test_standard_input_is_read(log, monkeypatch):
    with log.open("rb") as stream:
        monkeypatch.setattr(sys, "stdin", stream)
        source = open_live("-", attempt_s=0.3)
        assert len(list(source.frames())) == NUM_FRAMES
        source.close()


@pytest.mark.parametrize(("content", "told"), [
    (b"GET / HTTP/1.1\r\n\r\n", "begins with 47 45 54 20 .* expected an MCAP stream"),
    (b"\x89MCAP0\r\n" + b"\x05" + (1 << 40).to_bytes(8, "little") + bytes(100), "holds no record .*1099511627776"),
    (b"\x89MCAP0\r\n", "announced no topics; the stream has ended"),
])  # fmt: skip
def test_what_is_no_mcap_ends_in_one_line(content, told, tmp_path):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    write_in_thread(pipe, content)
    with pytest.raises(RecordingError, match=told):
        open_live(f"mcap:{pipe}", attempt_s=0.3)


@pytest.mark.parametrize(("uri", "told"), [
    ("mcap:none.mcap", "no such file or pipe, expected a pipe"),
    ("mcap:.", "a folder, expected"),
    ("gopher://robot", "found gopher://robot, expected one of zenoh://HOST"),
    *((f"foxglove://robot{end}", "expected foxglove://HOST") for end in (":0", ":port", "/x")),
    *((f"zenoh://robot:{port}", "expected zenoh://HOST") for port in ("0", "port", "99999")),
    ("dds://robot", r"found dds://robot, expected dds://\[DOMAIN\]"),
    ("dds://500", "with a DOMAIN of 0 to 232"),
    ("dds://0?peers=10.0.0.1", "expected dds://"),
    ("dds://0?interface=eth0", "names an interface and no peer: name the robot"),
    ("zed:desk.mp4", r"found zed:desk.mp4, expected zed://\[SERIAL\]"),
    ("zed:none.svo2", "found no such file"),
    *((f"zed://{end}", "expected zed://") for end in ("1.2.3.4:99999", "host/path")),
])  # fmt: skip
def test_an_address_that_names_nothing_is_refused(uri, told):
    with pytest.raises(RecordingError, match=told):
        open_live(uri, patience_s=0.1)


def test_addresses_are_told_from_files(tmp_path):
    assert all(is_live(uri) for uri in ("-", "mcap:x", "zenoh://b2"))
    assert not any(is_live(uri) for uri in ("log.mcap", str(tmp_path)))
