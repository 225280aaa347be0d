"""Seeded changes to a map folder: faults of disks, and malicious edits.

`change_map` edits a copy in place; files are replaced, never written into, so that the copy may be of hard links. Where
a file is guarded (a name with a hash, a CRC, a digest), half of the changes keep the guard right: it is the code behind
it that is tried.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import struct
import zlib
from typing import TYPE_CHECKING, Any

import cbor2
import zstandard

from hickory_stream.errors import HickoryError
from hickory_stream.journal.format import JOURNAL
from hickory_stream.journal.mcap_file import FileMessage, begin_file, end_file, write_chunk
from hickory_stream.journal.reader import JournalChunks
from hickory_stream.map_folder.digest import map_digest
from hickory_stream.map_folder.saved_map import open_map

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    import numpy as np

OUTSIDE = "OUTSIDE"
_HOSTILE: tuple[Any, ...] = (
    f"../../../../{OUTSIDE}/secret",
    f"../{OUTSIDE}/secret",
    "/etc/passwd",
    "",
    "\x1b[2J\x07",
    "x" * 5000,
    "NaN",
    None,
    True,
    -1,
    0,
    2**31,
    2**63,
    10**400,
    1e308,
    -1e308,
    1e-320,
    float("nan"),
    float("inf"),
    [],
    {},
    [[[[]]]],
)
_MESH_HEADER = 12
_BYTES = ("flip", "zero", "cut", "insert", "empty", "huge")
TARGETS = ("manifest", "objects", "view", "job", "points", "space", "mesh", "png", "journal", "ledger", "link", "pipe")


def change_map(path: Path, target: str, rng: np.random.Generator) -> str:
    """Change one thing of the map in a folder; return in a few words what."""
    match target:
        case "manifest" | "objects" | "ledger" | "view" | "job":
            return _change_json(path, _json_file(path, target, rng), rng)
        case "points" | "space":
            return _change_named(path, target, rng)
        case "mesh":
            return _change_mesh(_one(path / "shapes", "*.mesh", rng), rng)
        case "png":
            return _change_png(_one(path / "views", "*.png", rng), rng)
        case "journal":
            return _change_journal(path, rng)
        case "link":
            return _put_link(path, rng)
        case "pipe":
            victim = _any_file(path, rng)
            victim.unlink()
            os.mkfifo(victim)
            return f"{victim.relative_to(path)} is a pipe"
    raise ValueError(target)


def change_text(text: str, rng: np.random.Generator) -> str:
    """Return a TOML text with one thing changed: a value, or some characters."""
    lines = text.splitlines()
    places = [i for i, line in enumerate(lines) if "=" in line and not line.startswith("#")]
    if places and rng.random() < 0.7:
        place = places[int(rng.integers(len(places)))]
        value = _HOSTILE[int(rng.integers(len(_HOSTILE)))]
        told = {None: "nan", float("inf"): "inf"}.get(value if isinstance(value, float | None) else 0)
        lines[place] = f"{lines[place].split('=')[0]}= {told or json.dumps(value).replace('NaN', 'nan')}"
        return "\n".join(lines)
    return _damaged(text.encode(), rng)[0].decode("utf-8", errors="replace")


# ---- one kind of file each ------------------------------------------------------------------------------------------


def _json_file(path: Path, target: str, rng: np.random.Generator) -> Path:
    if target == "view":
        return _one(path / "views", "*.json", rng)
    if target == "job":
        return _one(path / "failed", "*/*", rng)
    if target == "ledger":
        return path / ("ledger.json" if rng.random() < 0.5 else "timings.json")
    return path / f"{target}.json"


def _change_json(path: Path, file: Path, rng: np.random.Generator) -> str:
    """Change the bytes of a file, or a value of its JSON; the digest is then made right in half of the cases."""
    name = file.relative_to(path)
    if file.suffix != ".json" or rng.random() < 0.25:
        data, told = _damaged(file.read_bytes(), rng)
        _replace(file, data)
        return f"{name}: {told}"
    document = json.loads(file.read_bytes())
    told = ", ".join(_change_value(document, rng) for _ in range(int(rng.integers(1, 4))))
    text = json.dumps(document)
    if rng.random() < 0.03:
        text, told = "[" * 200_000, "too deep"
    _replace(file, text.encode())
    if rng.random() < 0.5:
        _make_digest_right(path)
    return f"{name}: {told}"


def _change_named(path: Path, folder: str, rng: np.random.Generator) -> str:
    """Change a file whose name has the hash of its content; in most cases the name is made right again."""
    file = _one(path / folder, "*", rng)
    data = file.read_bytes()
    if rng.random() < 0.4:
        # What is compressed: the frame around it is whole.
        body, told = _damaged(zstandard.decompress(data), rng)
        changed = zstandard.compress(body)
    else:
        changed, told = _damaged(data, rng)
    if rng.random() < 0.8:
        stem = file.name.rpartition("-")[0]
        renamed = file.with_name(f"{stem}-{hashlib.sha256(changed).hexdigest()[:16]}{file.suffix}")
        file.unlink()
        renamed.write_bytes(changed)
        objects = path / "objects.json"
        _replace(objects, objects.read_bytes().replace(file.name.encode(), renamed.name.encode()))
        return f"{folder}/{file.name}: {told}, renamed"
    _replace(file, changed)
    return f"{folder}/{file.name}: {told}"


def _change_mesh(file: Path, rng: np.random.Generator) -> str:
    data = file.read_bytes()
    if rng.random() < 0.4:
        changed, told = _damaged(data, rng)
    else:
        # What is compressed: the frame around it is whole.
        body, told = _damaged(zstandard.decompress(data[_MESH_HEADER:]), rng)
        changed = data[:_MESH_HEADER] + zstandard.compress(body)
    _replace(file, changed)
    return f"{file.name}: {told}"


def _change_png(file: Path, rng: np.random.Generator) -> str:
    data = file.read_bytes()
    if rng.random() < 0.5:
        changed, told = _damaged(data, rng)
    else:
        # Another size or depth of the pixels, with the checksum made right.
        header = bytearray(data[12:29])
        width, height = (int(rng.choice([0, 1, 70_000, 2**31 - 1])) for _ in range(2))
        header[4:12] = struct.pack(">II", width, height)
        changed = data[:12] + bytes(header) + struct.pack(">I", zlib.crc32(header)) + data[33:]
        told = f"claims {width} x {height}"
    _replace(file, changed)
    return f"{file.name}: {told}"


def _change_journal(path: Path, rng: np.random.Generator) -> str:
    file = path / JOURNAL
    if rng.random() < 0.35:
        data, told = _damaged(file.read_bytes(), rng)
        _replace(file, data)
        return f"{JOURNAL}: {told}"
    found = JournalChunks(path)
    chunks = [found.messages(i, keeps=False) for i in range(len(found.places))]
    told = _change_message(chunks, rng)
    file.unlink()
    with file.open("w+b") as written:
        begin_file(written)
        for number, chunk in enumerate(chunks):
            write_chunk(written, chunk, number)
        end_file(written)
    return f"{JOURNAL}: {told}"


def _change_message(chunks: list[list[FileMessage]], rng: np.random.Generator) -> str:
    """Change one message of the chunks of a journal: its checksum will be right."""
    numbers = [(i, k) for i, chunk in enumerate(chunks) for k in range(len(chunk)) if chunk[k].channel != 3]
    i, k = numbers[int(rng.integers(len(numbers)))]
    message = chunks[i][k]
    # A list is changed in place, whatever the document is.
    document = [cbor2.loads(bytes(message.data))]
    told = f"chunk {i}, message {k}: {_change_value(document, rng)}"
    chunks[i][k] = message._replace(data=cbor2.dumps(document[0]))
    return told


def _put_link(path: Path, rng: np.random.Generator) -> str:
    """Put a link that leads out in the place of a file or a folder, or where a file would be written."""
    outside = path.parent / OUTSIDE
    names = ["views", "shapes", "points", "space", "failed", ".lock", ".objects.json.partial", ".journal.mcap.partial"]
    victim = _any_file(path, rng) if rng.random() < 0.5 else path / str(rng.choice(names))
    if victim.is_dir():
        moved = outside / victim.name
        victim.rename(moved)
        victim.symlink_to(moved)
    else:
        if victim.exists():
            shutil.copyfile(victim, outside / "secret")
            victim.unlink()
        victim.symlink_to(outside / "secret")
    return f"{victim.relative_to(path)} is a link"


# ---- bytes and values -----------------------------------------------------------------------------------------------


def _damaged(data: bytes, rng: np.random.Generator) -> tuple[bytes, str]:
    kind = str(rng.choice(_BYTES))
    if kind == "empty" or not data:
        return b"", "empty"
    at = int(rng.integers(len(data)))
    patches: dict[str, Callable[[], bytes]] = {
        "flip": lambda: data[:at] + bytes([data[at] ^ int(rng.integers(1, 256))]) + data[at + 1 :],
        "zero": lambda: data[:at] + bytes(min(64, len(data) - at)) + data[at + 64 :],
        "cut": lambda: data[:at],
        "insert": lambda: data[:at] + rng.bytes(int(rng.integers(1, 64))) + data[at:],
        "huge": lambda: data[:at] + b"\xff" * min(8, len(data) - at) + data[at + 8 :],
    }
    return patches[kind](), f"{kind} at {at}"


def _change_value(document: Any, rng: np.random.Generator) -> str:
    """Put something hostile in the place of a value of nested lists, dicts and tags, or take it out."""
    places = list(_places(document))
    container, key = places[int(rng.integers(len(places)))]
    if isinstance(container, dict) and rng.random() < 0.15:
        del container[key]
        return f"without {str(key)[:30]}"
    value = _HOSTILE[int(rng.integers(len(_HOSTILE)))]
    container[key] = value
    return f"{str(key)[:30]} = {str(value)[:30]!r}"


def _places(value: Any) -> Iterator[tuple[Any, Any]]:
    if isinstance(value, cbor2.CBORTag):
        yield from _places(value.value)
    elif isinstance(value, dict | list):
        for key, item in list(value.items()) if isinstance(value, dict) else list(enumerate(value)):
            yield value, key
            yield from _places(item)


def _make_digest_right(path: Path) -> None:
    """Write the digest of what is there into the manifest, as far as it can be read."""
    try:
        digest = map_digest(open_map(path, warns=False).snapshot)
        manifest = json.loads((path / "manifest.json").read_bytes())
    except (HickoryError, ValueError):
        return
    if manifest.get("finished_cleanly") is True:
        _replace(path / "manifest.json", json.dumps(manifest | {"digest": digest}).encode())


def _replace(file: Path, data: bytes) -> None:
    file.unlink()
    file.write_bytes(data)


def _one(folder: Path, pattern: str, rng: np.random.Generator) -> Path:
    files = sorted(folder.glob(pattern))
    return files[int(rng.integers(len(files)))]


def _any_file(path: Path, rng: np.random.Generator) -> Path:
    files = sorted(file for file in path.rglob("*") if file.is_file())
    return files[int(rng.integers(len(files)))]
