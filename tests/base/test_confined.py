import os
import numpy as np
import pytest
from hickory_stream.base.atomic_files import AtomicFiles
from hickory_stream.base.confined import OutsideError, open_new, path_within, plain_name, read_within, whole_number

BAD_NAMES = (
    "", ".", "..", "a/b", "/etc/passwd", "a\\b", "..\\b", "a..b", ".hidden", "-rf", "a b", "a\n", "ä", "a\0", "C:",
)  # fmt: skip
BAD_PATHS = ("", "/etc/passwd", "../b", "a/../../b", "a\\..\\b", "C:\\b", "a\0b", 7, None, ["a"])


@pytest.mark.parametrize("name", [*BAD_NAMES, "x" * 300, None, 7, True])
def test_what_is_no_plain_name_is_refused(name):
    with pytest.raises(OutsideError, match="expected a plain file name"):
        plain_name(name)


def test_a_plain_name_is_given_back_and_its_ending_is_asked_for():
    assert plain_name("000012-0003.glb", ".glb") == "000012-0003.glb"
    with pytest.raises(OutsideError, match=r"ending in \.glb"):
        plain_name("000012.glb.stl", ".glb")


@pytest.mark.parametrize("value", ["7", 7.0, True, None, -1, 10**400, 2**60, [7], float("nan")])
def test_what_is_no_id_is_refused_in_a_short_line(value):
    with pytest.raises(OutsideError, match="expected a whole number") as refusal:
        whole_number(value, "object")
    assert len(str(refusal.value)) < 200


def test_numbers_of_numpy_are_whole_numbers():
    assert whole_number(np.int64(7), "object") == 7


@pytest.mark.parametrize("name", BAD_PATHS)
def test_a_path_that_leads_out_is_refused(tmp_path, name):
    with pytest.raises(OutsideError):
        path_within(tmp_path, name)


def test_links_are_followed_within_the_folder_only(tmp_path):
    root = tmp_path / "root"
    (root / "a").mkdir(parents=True)
    (root / "a/file").write_text("inside")
    (tmp_path / "secret").write_text("outside")
    (root / "near").symlink_to("a")
    (root / "far").symlink_to(tmp_path)
    (root / "round").symlink_to("round")
    assert read_within(root, "near/file") == b"inside"
    for name in ("far/secret", "round/file"):
        with pytest.raises(OutsideError):
            read_within(root, name)


def test_a_folder_that_is_a_link_itself_is_read(tmp_path):
    (tmp_path / "real").mkdir()
    (tmp_path / "real/file").write_text("inside")
    (tmp_path / "link").symlink_to("real")
    assert read_within(tmp_path / "link", "file") == b"inside"


@pytest.mark.timeout(5)
def test_a_pipe_and_a_device_are_refused_and_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "folder").mkdir()
    for name in ("pipe", "folder"):
        with pytest.raises(OutsideError, match="is no regular file"):
            read_within(tmp_path, name)


def test_a_new_file_replaces_a_link_and_does_not_follow_it(tmp_path):
    (tmp_path / "precious").write_text("years of work")
    (tmp_path / "new").symlink_to("precious")
    with os.fdopen(open_new(tmp_path / "new"), "wb") as file:
        file.write(b"new")
    assert (tmp_path / "precious").read_text() == "years of work"
    assert (tmp_path / "new").read_bytes() == b"new"


FILES = {"a": b"first", "b": b"", "c": b"third"}


def _written(folder):
    with AtomicFiles() as new:
        for name, data in FILES.items():
            new.write(folder / name, b"torn")
            new.write(folder / name, data)
        assert not any((folder / name).exists() for name in FILES)
        new.commit()


def test_files_of_a_commit_have_their_last_content(tmp_path):
    _written(tmp_path)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == FILES


@pytest.mark.parametrize("num_synced", range(len(FILES)))
def test_no_file_gets_its_name_before_all_are_synced(tmp_path, monkeypatch, num_synced):
    results = iter([None] * num_synced)
    monkeypatch.setattr(os, "fsync", lambda descriptor: next(results))
    with pytest.raises(StopIteration):
        _written(tmp_path)
    assert list(tmp_path.iterdir()) == []
