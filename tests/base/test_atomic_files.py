import os
import pytest
from hickory_stream.base.atomic_files import AtomicFiles

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
