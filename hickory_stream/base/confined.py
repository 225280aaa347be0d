"""Checks of untrusted names, numbers and paths of maps, logs, jobs and truth folders.

A foreign folder may name only plain files within itself. All reads and writes under foreign names go through here.
"""

import os
import re
import stat
from collections.abc import Iterable
from pathlib import Path, PurePosixPath
from typing import Any, BinaryIO

_PLAIN = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_-]*(?:\.[A-Za-z0-9_-]+)*")
_LONGEST_NAME = 200
# Numbers that JSON, CBOR and an int64 all hold exactly.
_LARGEST = 2**53
_FOLLOW_NO_LINK = getattr(os, "O_NOFOLLOW", 0)


class OutsideError(ValueError):
    """An invalid name, or one that leads out of its folder."""


def plain_name(text: object, suffix: str = "") -> str:
    """Return a plain file name: letters, digits, `_`, `-` and single points between them, ending in `suffix`.

    Raises `OutsideError`: it is anything else.
    """
    is_plain = isinstance(text, str) and len(text) <= _LONGEST_NAME and _PLAIN.fullmatch(text)
    if not isinstance(text, str) or not is_plain or not text.endswith(suffix):
        wanted = f"a plain file name{f' ending in {suffix}' if suffix else ''}"
        raise OutsideError(f"found the name {_shown(text)}, expected {wanted}")
    return text


def whole_number(value: object, what: str, low: int = 0) -> int:
    """Return an integer of at least `low`, e.g. an id. Raises `OutsideError`: another type, or too large."""
    # NumPy's integers have an index, too; a bool has one by accident.
    if isinstance(value, bool) or not hasattr(value, "__index__"):
        raise OutsideError(f"found {what} {_shown(value)}, expected a whole number")
    number = int(value.__index__())
    if not low <= number <= _LARGEST:
        raise OutsideError(f"found {what} {_shown(number)}, expected a whole number of at least {low}")
    return number


def path_within(root: Path, name: object) -> Path:
    """Return the path of `name`, e.g. `meshes/3.glb`, under a folder; links are followed, and must not lead out.

    Raises `OutsideError`: the name is no relative path, or leads out of the folder.
    """
    is_relative = isinstance(name, str) and name and not re.search(r"[\\:\0]", name)
    if not isinstance(name, str) or not is_relative or name.startswith("/") or ".." in PurePosixPath(name).parts:
        raise OutsideError(f"found the path {_shown(name)}, expected one within {root}")
    path = root / name
    # Without a link it cannot lead out; `resolve` takes ten times as long, and a map has thousands of files.
    if os.name == "posix" and not _has_link(root, name):
        return path
    try:
        leads_out = not path.resolve().is_relative_to(root.resolve())
    except (OSError, RuntimeError) as error:
        raise OutsideError(f"{path} cannot be followed: {error}") from error
    if leads_out:
        raise OutsideError(f"{path} is a link that leads out of {root}")
    return path


def _has_link(root: Path, name: str) -> bool:
    at = os.fspath(root)
    for part in name.split("/"):
        at = f"{at}/{part}"
        if os.path.islink(at):  # noqa: PTH114 - a Path for each part would take twice as long
            return True
    return False


def open_within(root: Path, name: object) -> BinaryIO:
    """Return an open regular file under a folder.

    Raises `OutsideError`: the name leads out of the folder, or is a pipe, a device or a folder; `OSError`: no such
    file.
    """
    return _regular(path_within(root, name), os.O_RDONLY, "rb")


def read_within(root: Path, name: object) -> bytes:
    """Return the content of a regular file under a folder; raises as `open_within`."""
    with open_within(root, name) as file:
        return file.read()


def open_new(path: Path | str) -> int:
    """Return the descriptor of a new, empty file; an old file or link there is removed. Raises `OSError`."""
    flags = os.O_RDWR | os.O_CREAT | os.O_EXCL | _FOLLOW_NO_LINK | getattr(os, "O_BINARY", 0)
    try:
        return os.open(path, flags, 0o666)
    except FileExistsError:
        Path(path).unlink(missing_ok=True)
        return os.open(path, flags, 0o666)


def open_to_change(path: Path) -> BinaryIO:
    """Return a regular file to read and write; a link is not followed.

    Raises `OutsideError`: it is a pipe, a device or a folder; `OSError`: there is no such file, or it is a link.
    """
    return _regular(path, os.O_RDWR | _FOLLOW_NO_LINK, "r+b")


def _regular(path: Path, flags: int, mode: str) -> Any:
    # Opening a pipe without a writer would block.
    descriptor = os.open(path, flags | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise OutsideError(f"{path} is no regular file")
    return os.fdopen(descriptor, mode)


def refuse_links(root: Path, names: Iterable[str]) -> None:
    """Raise `OutsideError`, with its name, if one of these entries of a folder is a link."""
    for name in names:
        if (root / name).is_symlink():
            raise OutsideError(f"{root / name} is a link; replace it by what it points to")


def _shown(value: object) -> str:
    text = repr(value) if not isinstance(value, int) or abs(value) < 10**30 else "of many digits"
    return text if len(text) <= 80 else f"{text[:77]}..."
