"""Seeded changes to a map folder: faults of disks, and malicious edits."""
# `change_map` replaces files, since copies may share hard links. Half of the changes keep hashes and CRCs right, to
# test the code behind them.

import hashlib
import json
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cbor2
import numpy as np
import zstandard

from hickory_stream.errors import HickoryError
from hickory_stream.journal.format import COLOR, JOURNAL
from hickory_stream.journal.mcap_file import begin_file, end_file, write_chunk
from hickory_stream.journal.reader import JournalChunks
from hickory_stream.map_folder.digest import map_digest
from hickory_stream.map_folder.saved_map import open_map

OUTSIDE = "OUTSIDE"
_SECRETS = (f"../../../../{OUTSIDE}/secret", f"../{OUTSIDE}/secret", "/etc/passwd")
_NUMBERS = (-1, 0, 2**31, 2**63, 10**400, 1e308, -1e308, 1e-320, float("nan"), float("inf"))
_HOSTILE: tuple[Any, ...] = (
    *(*_SECRETS, "", "\x1b[2J\x07", "x" * 5000, "NaN", None, True),
    *(*_NUMBERS, [], {}, [[[[]]]]),
)
_MESH_HEADER = 12
_BYTES = ("flip", "zero", "cut", "insert", "empty", "huge")
TARGETS = ("manifest", "objects", "view", "job", "points", "space", "mesh", "journal", "ledger", "link", "pipe")


def change_map(path: Path, target: str, rng: np.random.Generator) -> str:
    """Change one thing of the map in a folder; return a description in a few words."""
    match target:
        case "manifest" | "objects":
            return _change_json(path, path / f"{target}.json", rng)
        case "ledger":
            return _change_json(path, path / ("ledger.json" if rng.random() < 0.5 else "timings.json"), rng)
        case "view":
            file = _one(path / "views", "*.view", rng)
            return f"{file.name}: {_replace_compressed(file, 0, rng)}"
        case "job":
            return _change_json(path, _one(path / "failed", "*/*", rng), rng)
        case "points" | "space":
            return _change_named(path, target, rng)
        case "mesh":
            file = _one(path / "shapes", "*.mesh", rng)
            return f"{file.name}: {_replace_compressed(file, _MESH_HEADER, rng)}"
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
        word = {None: "nan", float("inf"): "inf"}.get(value if isinstance(value, float | None) else 0)
        lines[place] = f"{lines[place].split('=')[0]}= {word or json.dumps(value).replace('NaN', 'nan')}"
        return "\n".join(lines)
    return _damaged(text.encode(), rng)[0].decode("utf-8", errors="replace")


def _change_json(path: Path, file: Path, rng: np.random.Generator) -> str:
    name = file.relative_to(path)
    if file.suffix != ".json" or rng.random() < 0.25:
        data, change = _damaged(file.read_bytes(), rng)
        _replace(file, data)
        return f"{name}: {change}"
    document = json.loads(file.read_bytes())
    change = ", ".join(_change_value(document, rng) for _ in range(int(rng.integers(1, 4))))
    text = json.dumps(document)
    if rng.random() < 0.03:
        text, change = "[" * 200_000, "too deep"
    _replace(file, text.encode())
    if rng.random() < 0.5:
        _make_digest_right(path)
    return f"{name}: {change}"


def _change_named(path: Path, folder: str, rng: np.random.Generator) -> str:
    file = _one(path / folder, "*", rng)
    change = _replace_compressed(file, 0, rng)
    if rng.random() < 0.8:
        stem = file.name.rpartition("-")[0]
        renamed = f"{stem}-{hashlib.sha256(file.read_bytes()).hexdigest()[:16]}{file.suffix}"
        file.rename(file.with_name(renamed))
        objects = path / "objects.json"
        _replace(objects, objects.read_bytes().replace(file.name.encode(), renamed.encode()))
        change += ", renamed"
    return f"{folder}/{file.name}: {change}"


def _replace_compressed(file: Path, header: int, rng: np.random.Generator) -> str:
    data = file.read_bytes()
    if rng.random() < 0.5:
        changed, change = _damaged(data, rng)
    else:
        body, change = _damaged(zstandard.decompress(data[header:]), rng)
        changed = data[:header] + zstandard.compress(body)
    _replace(file, changed)
    return change


def _change_journal(path: Path, rng: np.random.Generator) -> str:
    file = path / JOURNAL
    if rng.random() < 0.35:
        data, change = _damaged(file.read_bytes(), rng)
        _replace(file, data)
        return f"{JOURNAL}: {change}"
    found = JournalChunks(path)
    chunks = [list(found.messages(i)) for i in range(len(found.places))]
    numbers = [(i, k) for i, chunk in enumerate(chunks) for k in range(len(chunk)) if chunk[k].channel != COLOR]
    i, k = numbers[int(rng.integers(len(numbers)))]
    # A list is changed in place, whatever the document is.
    document = [cbor2.loads(chunks[i][k].data)]
    change = f"chunk {i}, message {k}: {_change_value(document, rng)}"
    chunks[i][k] = chunks[i][k]._replace(data=cbor2.dumps(document[0]))
    file.unlink()
    with file.open("w+b") as written:
        begin_file(written)
        for number, chunk in enumerate(chunks):
            write_chunk(written, chunk, number)
        end_file(written)
    return f"{JOURNAL}: {change}"


def _put_link(path: Path, rng: np.random.Generator) -> str:
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


def _damaged(data: bytes, rng: np.random.Generator) -> tuple[bytes, str]:
    kind = str(rng.choice(_BYTES))
    if kind == "empty" or not data:
        return b"", "empty"
    at = int(rng.integers(len(data)))
    before, after = data[:at], data[at:]
    match kind:
        case "flip":
            after = bytes([after[0] ^ int(rng.integers(1, 256))]) + after[1:]
        case "zero":
            after = bytes(min(64, len(after))) + after[64:]
        case "cut":
            after = b""
        case "insert":
            after = rng.bytes(int(rng.integers(1, 64))) + after
        case _:
            after = b"\xff" * min(8, len(after)) + after[8:]
    return before + after, f"{kind} at {at}"


def _change_value(document: Any, rng: np.random.Generator) -> str:
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
