import os
import subprocess
import sys
import pytest
from hickory_stream.errors import MapFolderError
from hickory_stream.map_folder.layout import LOCK, FolderLock, check_unlocked

HOLD = """
import sys, pathlib
from hickory_stream.map_folder.layout import FolderLock
lock = FolderLock(pathlib.Path(sys.argv[1]))
print("held", flush=True)
sys.stdin.readline()
"""


def test_a_second_process_is_refused_until_the_first_is_killed(tmp_path):
    holder = subprocess.Popen(
        [sys.executable, "-c", HOLD, str(tmp_path)], text=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )
    assert holder.stdout.readline() == "held\n"
    with pytest.raises(MapFolderError, match=f"is being written by process {holder.pid};"):
        FolderLock(tmp_path)
    with pytest.raises(MapFolderError, match=str(holder.pid)):
        check_unlocked(tmp_path)
    holder.kill()
    holder.communicate()
    FolderLock(tmp_path).release()
    assert not (tmp_path / LOCK).exists()


def test_a_released_or_forgotten_lock_can_be_taken_again(tmp_path):
    lock = FolderLock(tmp_path)
    assert (tmp_path / LOCK).read_text() == f"{os.getpid()}\n"
    lock.release()
    lock.release()
    again = FolderLock(tmp_path)
    del again
    FolderLock(tmp_path).release()
