import hashlib
import http.server
import threading
import numpy as np
import pytest
from hickory_stream.errors import ModelError
from hickory_stream.perception.models.library import KINDS
from hickory_stream.perception.models.published import PUBLISHED, Published, PublishedFile, collect

WHOLE = np.random.default_rng(1).bytes(300_000)
SMALL = b"{}"


class Server(http.server.BaseHTTPRequestHandler):
    """Serves `files`; ends a connection after `most` bytes; knows no ranges if `has_ranges` is False."""

    files, most, has_ranges, asked = {}, 10**9, True, []

    def do_GET(self):
        name, start = self.path.rpartition("/")[2], self.headers.get("Range", "bytes=0-")
        self.asked.append((name, start))
        if name not in self.files:
            self.send_error(404)
            return
        whole, begin = self.files[name], int(start[6:-1]) if self.has_ranges else 0
        if begin >= len(whole):
            self.send_error(416)
            return
        self.send_response(206 if begin else 200)
        self.send_header("Content-Length", str(len(whole) - begin))
        self.end_headers()
        self.wfile.write(whole[begin : begin + self.most])

    def log_message(self, *_):
        pass


@pytest.fixture
def server():
    kind = type("Kind", (Server,), {"files": {"a.bin": WHOLE, "c.json": SMALL}, "asked": []})
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), kind) as running:
        threading.Thread(target=running.serve_forever, args=(0.01,), daemon=True).start()
        kind.address = f"http://127.0.0.1:{running.server_address[1]}/models"
        yield kind
        running.shutdown()


def weights(address, **files):
    files = files or {"a.bin": WHOLE, "c.json": SMALL}
    made = tuple(
        PublishedFile(name=name, num_bytes=len(data), sha256=hashlib.sha256(data).hexdigest())
        for name, data in files.items()
    )
    return Published(name="small", kind="dinov2", licence="CC0-1.0", address=address, files=made)


def test_files_arrive_whole_and_are_fetched_once(server, tmp_path):
    done = []
    collect(weights(server.address), tmp_path, progress=done.append)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == {"a.bin": WHOLE, "c.json": SMALL}
    assert done[-1] == len(WHOLE) + len(SMALL)
    assert done == sorted(done)
    collect(weights(server.address), tmp_path)
    assert len(server.asked) == 2


def test_a_connection_that_breaks_continues_where_it_ended(server, tmp_path):
    server.most = 130_000
    collect(weights(server.address), tmp_path)
    assert (tmp_path / "a.bin").read_bytes() == WHOLE
    starts = [start for name, start in server.asked if name == "a.bin"]
    assert starts == ["bytes=0-", "bytes=130000-", "bytes=260000-"]


def test_a_download_that_stops_is_kept_for_the_next_command(server, tmp_path):
    (tmp_path / "a.bin.part").write_bytes(WHOLE[:100_000])
    server.most = 0
    with pytest.raises(ModelError, match=r"broke off at 100000 of 300000 bytes .*the same command continues there"):
        collect(weights(server.address), tmp_path)
    server.most = 10**9
    collect(weights(server.address), tmp_path)
    assert (tmp_path / "a.bin").read_bytes() == WHOLE
    assert server.asked[-2] == ("a.bin", "bytes=100000-")


def test_a_server_without_ranges_begins_from_the_start(server, tmp_path):
    (tmp_path / "a.bin.part").write_bytes(b"x" * 1000)
    server.has_ranges = False
    collect(weights(server.address), tmp_path)
    assert (tmp_path / "a.bin").read_bytes() == WHOLE


@pytest.mark.parametrize("has_ranges", [True, False])
@pytest.mark.parametrize("other", [WHOLE[:-1] + b"x", WHOLE[:1000], WHOLE * 2], ids=["other", "shorter", "longer"])
def test_a_file_with_another_hash_is_refused_and_removed(server, tmp_path, other, has_ranges):
    server.has_ranges, server.files = has_ranges, {"a.bin": other, "c.json": SMALL}
    with pytest.raises(ModelError, match=r"has sha256 \w{64}, expected \w{64}.*nothing was added"):
        collect(weights(server.address), tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_an_address_without_the_file_is_one_line(server, tmp_path):
    with pytest.raises(ModelError, match=r"/b.bin answers 404 .* get b.bin by hand, and use --from FOLDER"):
        collect(weights(server.address, **{"b.bin": b"b"}), tmp_path)
    with pytest.raises(ModelError, match=r"a.bin cannot be reached \(.*refused.*use --from FOLDER"):
        collect(weights("http://127.0.0.1:9/none"), tmp_path)


def test_a_folder_or_a_mirror_takes_the_publishers_place(server, tmp_path):
    given, wrong = tmp_path / "given", tmp_path / "wrong"
    for folder, last in ((given, b""), (wrong, b"x")):
        folder.mkdir()
        (folder / "a.bin").write_bytes(WHOLE + last)
        (folder / "c.json").write_bytes(SMALL)
    published = weights("http://127.0.0.1:9/none")
    collect(published, tmp_path / "a", str(given))
    collect(published, tmp_path / "b", server.address)
    assert [(tmp_path / name / "a.bin").read_bytes() == WHOLE for name in "ab"] == [True, True]
    with pytest.raises(ModelError, match="has sha256"):
        collect(published, tmp_path / "c", str(wrong))
    assert (wrong / "a.bin").exists()
    with pytest.raises(ModelError, match=r"a.bin is missing; --from needs a folder"):
        collect(published, tmp_path / "c", str(tmp_path / "none"))


def test_the_table_names_kinds_licences_and_whole_hashes():
    for model in PUBLISHED.values():
        assert model.kind in KINDS
        assert model.licence
        assert model.address.startswith("https://")
        assert all(len(file.sha256) == 64 and file.num_bytes > 0 for file in model.files)
        assert bool(model.licence_note) == ("AGPL" in model.licence)
