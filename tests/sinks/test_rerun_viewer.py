import os
import socket
import subprocess
import sys
import textwrap
import threading
import time
import warnings
from pathlib import Path
import cv2
import numpy as np
import pytest
import rerun as rr
from hypothesis import given
from hypothesis import strategies as st
from rerun.chunk import RrdReader
from hickory_stream.errors import ViewerError
from hickory_stream.geometry.display import color_of_id
from hickory_stream.sinks.rerun import viewer
from hickory_stream.sinks.rerun.config import RerunConfig
from hickory_stream.sinks.rerun.items import LogItem, Moment, Span, Weight
from hickory_stream.sinks.rerun.live import LiveQueue
from hickory_stream.sinks.rerun.sink import RerunSink
from tests.sinks.report_fixtures import reports

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize("kind", ["none", "spawn", "web"])
def test_a_viewer_is_chosen_by_its_name(kind):
    assert viewer.parse_viewer(kind) == viewer.ViewerChoice(kind=viewer.ViewerKind(kind))


@pytest.mark.parametrize("text", ["rerun+http://10.0.0.7:9001/proxy", "10.0.0.7:9001"])
def test_a_running_viewer_is_named_by_url_or_host_and_port(text):
    choice = viewer.parse_viewer(f"connect={text}")
    assert choice.kind is viewer.ViewerKind.CONNECT
    assert viewer.host_and_port(choice.url) == ("10.0.0.7", 9001)


@pytest.mark.parametrize(
    "text", ["", "windo", "connect", "connect=", "connect=http://a/proxy", "connect=rerun://a/other", "connect=a:b"]
)
def test_anything_else_is_refused_with_the_choices(text):
    with pytest.raises(ViewerError, match=r"rerun\+http://HOST:PORT|auto, none, spawn, web, or connect=URL"):
        viewer.parse_viewer(text)


def test_a_window_opens_only_where_there_is_a_screen(monkeypatch):
    monkeypatch.setattr("sys.platform", "linux")
    for name in ("WAYLAND_DISPLAY", "DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    assert viewer.parse_viewer("auto").kind is viewer.ViewerKind.NONE
    with pytest.raises(ViewerError, match="--viewer web"):
        viewer.start_viewer(viewer.parse_viewer("spawn"), bind="127.0.0.1", server_memory_limit="1MB")
    monkeypatch.setenv("DISPLAY", ":0")
    assert viewer.parse_viewer("auto").kind is viewer.ViewerKind.SPAWN


def test_an_address_that_is_not_ours_is_refused():
    with pytest.raises(ViewerError, match=r"192\.0\.2\.1"):
        viewer.free_port(0, bind="192.0.2.1")


@pytest.mark.parametrize("file", ["README.md", "tools/demo"])
def test_commands_for_a_viewer_listen_on_this_machine_only(file):
    lines = [line for line in (ROOT / file).read_text().splitlines() if "bin/rerun " in line]
    assert lines
    assert all("bin/rerun --bind 127.0.0.1 " in line for line in lines)


@given(st.integers(0, 2000), st.integers(1, 4))
def test_neighbouring_ids_have_distinct_colours(object_id, step):
    a, b = color_of_id(object_id), color_of_id(object_id + step)
    assert sum(abs(x - y) for x, y in zip(a, b, strict=True)) >= 60


LOOK = Path(__file__).resolve().parents[2] / "tools" / "look"


def look(*arguments):
    return subprocess.run([sys.executable, LOOK, *arguments], capture_output=True, text=True, check=False)


def test_the_default_arrangement_is_drawn_without_complaint(tmp_path):
    sink = RerunSink(RerunConfig(), tmp_path, tmp_path / "run.rrd", viewer.parse_viewer("none"))
    for report in reports(17, tmp_path):
        sink.show(report)
    sink.close()
    done = look(tmp_path / "run.rrd", "-o", tmp_path / "picture.png", "--size", "800x600")
    if done.returncode == 2 and "Vulkan" in done.stderr:
        pytest.skip(done.stderr)
    assert done.returncode == 0, done.stderr
    assert " 0 complaints" in done.stdout
    picture = cv2.imread(str(tmp_path / "picture.png"))
    assert picture.shape == (600, 800, 3)
    colorful = np.ptp(picture.astype(int), axis=2) > 60
    assert colorful.mean() > 0.01


def test_a_file_that_is_not_there_is_named(tmp_path):
    done = look(tmp_path / "none.rrd", "-o", tmp_path / "picture.png")
    assert done.returncode == 2
    assert "none.rrd" in done.stderr


def test_a_size_that_is_none_is_refused(tmp_path):
    (tmp_path / "a.rrd").touch()
    done = look(tmp_path / "a.rrd", "-o", tmp_path / "picture.png", "--size", "big")
    assert done.returncode == 2
    assert "1600x900" in done.stderr


@pytest.fixture
def quiet_home(tmp_path, monkeypatch):
    """A home folder for viewers in which usage statistics are off."""
    home = tmp_path / "home"
    home.mkdir()
    for name in ("HOME", "XDG_CONFIG_HOME", "XDG_DATA_HOME"):
        monkeypatch.setenv(name, str(home))
    subprocess.run([viewer.viewer_binary(), "analytics", "disable"], check=True, capture_output=True)
    return home


@pytest.fixture
def silent_server():
    """A server that accepts and never reads."""
    server = socket.create_server(("127.0.0.1", 0))
    accepted = []

    def accept():
        while True:
            try:
                accepted.append(server.accept()[0])
            except OSError:
                return

    threading.Thread(target=accept, daemon=True).start()
    yield server.getsockname()[1]
    server.close()
    for connection in accepted:
        connection.close()


def wait_for(condition, what):
    deadline = time.monotonic() + 10
    while not condition():
        assert time.monotonic() < deadline, what
        time.sleep(0.02)


# The process of its own proves as well that the interpreter ends: Rerun's exit handler waits for stalled viewers.
RUN = textwrap.dedent(
    """
    import sys
    from pathlib import Path
    from tests.sinks.report_fixtures import reports
    from hickory_stream.sinks.rerun.config import RerunConfig
    from hickory_stream.sinks.rerun.sink import RerunSink, parse_viewer
    folder = Path(sys.argv[1])
    config = RerunConfig(live_queue_length=16)
    sink = RerunSink(config, folder, folder / "run.rrd", parse_viewer(f"connect={sys.argv[2]}"))
    for report in reports(48, folder, width=64):
        sink.show(report)
    sink.close()
    print(sink.dropped["heavy"])
    """
)


def run_against(port, folder):
    done = subprocess.run(
        [sys.executable, "-c", RUN, str(folder), f"127.0.0.1:{port}"], capture_output=True, text=True,
        timeout=60, check=True, env={**os.environ, "PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    frames = {
        frame
        for chunk in RrdReader(folder / "run.rrd").stream()
        if chunk.entity_path == "/world/camera" and not chunk.is_static
        for frame in chunk.to_record_batch().column("frame").to_pylist()
    }
    return int(done.stdout.split()[-1]), frames


@pytest.mark.parametrize("is_there", [True, False])
def test_a_viewer_that_never_reads_or_is_missing_costs_drops(tmp_path, silent_server, is_there):
    dropped, frames = run_against(silent_server if is_there else viewer.free_port(0), tmp_path)
    assert dropped > 0
    assert frames == set(range(48))


class Receiver:
    """A real Rerun server that saves what it gets."""

    def __init__(self, port, path):
        command = [viewer.viewer_binary(), "--save", str(path), "--bind", "127.0.0.1", "--port", str(port)]
        self.process = subprocess.Popen(
            command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=viewer.viewer_environment()
        )
        self.path = path

    def entities(self):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the file is read while it grows: it has no footer yet
            try:
                return {chunk.entity_path for chunk in RrdReader(self.path).stream()}
            except (OSError, ValueError, RuntimeError):
                return set()

    def kill(self):
        self.process.kill()
        self.process.wait()


def test_a_late_or_returning_viewer_gets_earlier_objects(tmp_path, quiet_home):
    port = viewer.free_port(0)
    sink = RerunSink(RerunConfig(live_queue_length=8), tmp_path, None, viewer.parse_viewer(f"connect=127.0.0.1:{port}"))
    run = reports(24, tmp_path, width=160)
    for _ in range(20):
        sink.show(next(run))
    first, second = None, None
    wanted = {f"/world/layer{layer}/1" for layer in (2, 3, 4)} | {"/world/layer1/1/points", "/world/camera"}
    try:
        first = Receiver(port, tmp_path / "first.rrd")
        wait_for(lambda: wanted <= first.entities(), "the late viewer did not get the objects")
        first.kill()
        second = Receiver(port, tmp_path / "second.rrd")

        def shown_again():
            # Only writing tells that a connection was lost.
            if (report := next(run, None)) is not None:
                sink.show(report)
            return wanted <= second.entities()

        wait_for(shown_again, "the viewer that came back did not get the objects")
    finally:
        sink.close()
        for receiver in (first, second):
            if receiver is not None:
                receiver.kill()


def test_the_web_viewer_is_on_loopback_and_ends_with_the_sink(tmp_path, quiet_home):
    import psutil

    sink = RerunSink(RerunConfig(), tmp_path, None, viewer.parse_viewer("web"))
    process = psutil.Process(sink._viewer.process.pid)
    ports = {viewer.host_and_port(sink.web_url)[1], viewer.host_and_port(sink._viewer.url)[1]}

    def listening():
        return [c.laddr for c in process.net_connections(kind="tcp") if c.status == psutil.CONN_LISTEN]

    try:
        wait_for(lambda: ports <= {address.port for address in listening()}, "the server did not come up")
        assert {address.ip for address in listening()} == {"127.0.0.1"}
    finally:
        sink.close()
    assert not process.is_running()


def item(path, weight=Weight.LIGHT, span=Span.LASTING, is_clear=False):
    return LogItem(path=path, archetypes=(rr.Clear(recursive=True),), weight=weight, span=span, is_clear=is_clear)


def moment(frame):
    return Moment(stamp_ns=frame, frame=frame, keyframe=None)


def drained(queue):
    entries = []
    while (entry := queue.take(0.0)) is not None:
        entries += [(entry.moment.frame, i.path) for i in entry.items]
    return entries


def test_a_full_queue_drops_its_oldest_heavy_entry():
    queue = LiveQueue(capacity=3)
    for frame in range(3):
        queue.put(moment(frame), [item("light", span=Span.MOMENT), item("image", Weight.HEAVY, Span.MOMENT)])
    assert drained(queue) == [(0, "light"), (1, "light"), (2, "light")]
    assert queue.dropped() == {"light": 0, "heavy": 3}


def test_a_dropped_lasting_item_comes_later_in_its_last_form():
    queue = LiveQueue(capacity=2)
    queue.put(moment(0), [item("cloud", Weight.HEAVY)])
    queue.put(moment(1), [item("cloud", Weight.HEAVY)])
    queue.put(moment(2), [])
    queue.put(moment(3), [])
    assert drained(queue) == [(1, "cloud")]


def test_a_cleared_entity_does_not_come_back():
    queue = LiveQueue(capacity=10)
    queue.put(moment(0), [item("layer/1/points", Weight.HEAVY), item("layer/12", Weight.HEAVY)])
    queue.put(moment(1), [item("layer/1", is_clear=True)])
    drained(queue)
    queue.start_over()
    assert drained(queue) == [(1, "layer/1"), (0, "layer/12")]
