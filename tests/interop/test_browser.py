"""The web viewer and the exported page in a real browser, Chromium without a screen.

The viewer, opened after the run, shows the whole map at its end. The pictures are kept in the test's folder
(`--basetemp`), to be looked at.
"""

import base64
import json
import shutil
import subprocess
import urllib.request
from contextlib import ExitStack
from itertools import pairwise
import cv2
import numpy as np
import psutil
import pytest
from websockets.sync.client import connect
from hickory_stream.map_folder.saved_map import open_map
from hickory_stream.sinks.rerun.config import RerunConfig
from hickory_stream.sinks.rerun.sink import RerunSink
from hickory_stream.sinks.rerun.viewer import parse_viewer
from tests.cli.test_cli import look
from tests.players.live.robot_fixtures import eventually
from tests.sinks.report_fixtures import boxes, reports

pytestmark = [pytest.mark.interop, pytest.mark.timeout(240)]
BROWSER = next((path for name in ("chromium", "chromium-browser", "google-chrome") if (path := shutil.which(name))), "")
SIZE = (1280, 800)
SCENE = np.s_[70:620, 0:630]
"""Rows and columns of the page that show layers 1 and 2."""


@pytest.fixture
def shown(tmp_path):
    """A sink with a web viewer to which a whole run was shown."""
    sink = RerunSink(RerunConfig(), tmp_path, None, parse_viewer("web"))
    for report in reports(30, tmp_path):
        sink.show(report)
    yield sink
    sink.close()


class Page:
    """A page in a Chromium without a screen, by the DevTools protocol."""

    def __init__(self, url, profile):
        drawing = ("--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist")
        command = [BROWSER, "--headless=new", "--no-sandbox", "--disable-dev-shm-usage", *drawing]
        command += [f"--user-data-dir={profile}", f"--window-size={SIZE[0]},{SIZE[1]}", "--remote-debugging-port=0"]
        self._process = subprocess.Popen([*command, url], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        port_file = profile / "DevToolsActivePort"
        assert eventually(lambda: port_file.exists() and "\n" in port_file.read_text(), 60.0)
        port = int(port_file.read_text().splitlines()[0])
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/json") as answer:
            (page,) = [found for found in json.load(answer) if found["type"] == "page"]
        self._stack = ExitStack()
        self._connection = self._stack.enter_context(connect(page["webSocketDebuggerUrl"], max_size=None, proxy=None))
        self._number = 0

    def ask(self, method, **parameters):
        """Return the browser's answer."""
        self._number += 1
        self._connection.send(json.dumps({"id": self._number, "method": method, "params": parameters}))
        while (said := json.loads(self._connection.recv(60.0))).get("id") != self._number:
            pass
        return said["result"]

    def picture(self):
        """Return what it shows now (PNG)."""
        return base64.b64decode(self.ask("Page.captureScreenshot")["data"])

    def value(self, expression):
        """Return the value of an expression in the page."""
        return self.ask("Runtime.evaluate", expression=expression, returnByValue=True)["result"].get("value")

    def close(self):
        self._stack.close()
        self._process.terminate()
        self._process.wait(10.0)


def colors_of(picture):
    """Return how many different hues the view of layers 1 and 2 shows, each on many pixels."""
    page = cv2.imdecode(np.frombuffer(picture, np.uint8), cv2.IMREAD_COLOR)
    assert page is not None
    hues, saturations, values = cv2.split(cv2.cvtColor(np.ascontiguousarray(page[SCENE]), cv2.COLOR_BGR2HSV))
    bins = np.bincount(hues[(saturations > 90) & (values > 60)] // 15, minlength=12)
    return int((bins > 300).sum())


@pytest.mark.skipif(not BROWSER, reason="needs Chromium")
def test_a_browser_that_comes_late_shows_every_object(shown, tmp_path):
    page = Page(str(shown.web_url), tmp_path / "profile")
    pictures = []

    def is_whole():
        pictures.append(page.picture())
        # Of the colours of seven boxes one is grey, and two others are close.
        return colors_of(pictures[-1]) >= len(boxes()) - 3

    try:
        found = eventually(is_whole, 120.0)
    finally:
        page.close()
        if pictures:
            (tmp_path / "page.png").write_bytes(pictures[-1])
    assert found, colors_of(pictures[-1])


@pytest.mark.skipif(not BROWSER, reason="needs Chromium")
def test_the_exported_page_shows_and_switches_layers(short_map, tmp_path):
    out = tmp_path / "map.html"
    assert look("export", short_map, "-o", out, "--texture", 64).status == 0
    page = Page(out.as_uri(), tmp_path / "profile")

    def settled():
        assert eventually(lambda: page.value("document.body.dataset.state === 'ready' && !isAsked"), 60.0)
        (tmp_path / "page.png").write_bytes(page.picture())
        shown = cv2.imread(str(tmp_path / "page.png"))
        assert shown is not None
        return shown[:, 310:].tobytes()

    try:
        pictures = [settled()]
        assert page.value("document.getElementById('message').textContent") == ""
        for name in ("tint", "points", "object", "superquadrics", "inflated", "room", "grid", "tags"):
            page.value(f"document.getElementById('show-{name}').click()")
            pictures.append(settled())
        first = open_map(short_map).snapshot.objects[0].id
        page.value("document.querySelector('#list button').click()")
        pictures.append(settled())
        assert page.value("document.getElementById('facts').textContent").startswith(f"#{first}, ")
        assert page.value("chosen") == first
        # What the middle of the view shows can be clicked.
        assert page.value("objectAt({offsetX: view.clientWidth / 2, offsetY: view.clientHeight / 2})") is not None
    finally:
        page.close()
    assert all(a != b for a, b in pairwise(pictures))


def test_the_page_is_reachable_from_this_machine_only(shown):
    assert shown.web_url is not None
    assert shown.web_url.startswith("http://127.0.0.1:")
    heard = {
        connection.laddr.ip for child in psutil.Process().children(recursive=True)
        for connection in child.net_connections(kind="tcp") if connection.status == psutil.CONN_LISTEN
    }  # fmt: skip
    assert heard == {"127.0.0.1"}
