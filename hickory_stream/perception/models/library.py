"""The folder of networks: the model files and their manifest.

A file is used only with an entry in `manifest.json` (sha256, origin, licence, input size). A run downloads nothing;
the error for a missing model says how to get it.
"""

import dataclasses
import hashlib
import json
import os
import re
import shutil
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

from platformdirs import user_data_path

from hickory_stream.base.json_text import dumps_exactly
from hickory_stream.errors import ModelError

Kind = Literal["fastsam", "sam", "dinov2", "oneformer", "semantic", "image-text"]
KINDS: tuple[Kind, ...] = get_args(Kind)

MANIFEST = "manifest.json"
_FORMAT = 1
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]*")
# What `models get` calls the published weights of a kind.
_PUBLISHED: dict[Kind, tuple[str, ...]] = {
    "fastsam": ("fastsam-s", "fastsam-x"),
    "dinov2": ("dinov2-small",),
    "oneformer": ("oneformer-ade20k",),
}
_GRAPHS: dict[Kind, str] = {
    "sam": "any folder with encoder and decoder of SAM, MobileSAM or SAM 2 as ONNX",
    "semantic": "any graph that gives class scores per pixel (1, K, h, w), or class ids (1, h, w)",
    "image-text": "any folder with a pair of graphs as CLIP has them, their tokenizer and their pre-processing",
}


@dataclass(frozen=True, kw_only=True, slots=True)
class Companion:
    """A further file that a network needs, by its `role`."""

    role: str
    file: str
    sha256: str

    def __post_init__(self) -> None:
        _require_file(self.file, self.sha256)


@dataclass(frozen=True, kw_only=True, slots=True)
class ModelEntry:
    """The manifest's entry of a network."""

    #: name in the configuration; also the stem of its file
    name: str
    #: what it computes; determines how its tensors are interpreted
    kind: Kind
    file: str
    sha256: str
    #: origin of the weights
    source: str
    licence: str
    #: width and height of the graph's input, 0 for any
    input_px: tuple[int, int] = (0, 0)
    #: names of its classes in the order of their ids
    labels: tuple[str, ...] = ()
    #: further files, e.g. the tokenizer of an image-text network
    companions: tuple[Companion, ...] = ()

    def __post_init__(self) -> None:
        if not _NAME.fullmatch(self.name):
            raise ValueError(f"the name {self.name!r} is not made of letters, digits, points, hyphens and underscores")
        if self.kind not in KINDS:
            raise ValueError(f"found kind {self.kind!r}, expected one of {', '.join(KINDS)}")
        _require_file(self.file, self.sha256)
        if len(self.input_px) != 2 or not all(isinstance(n, int) and n >= 0 for n in self.input_px):
            raise ValueError(f"found input_px {self.input_px!r}, expected width and height in pixels, 0 for any")

    @property
    def files(self) -> dict[str, str]:
        """All its files in the folder, each with its sha256."""
        return {self.file: self.sha256, **{one.file: one.sha256 for one in self.companions}}

    def companion(self, role: str) -> str:
        """Return the name of the file with a role; raises `ModelError` if there is none."""
        found = next((one.file for one in self.companions if one.role == role), None)
        if found is None:
            raise ModelError(f"the model {self.name} has no {role} in {MANIFEST}; {how_to_get(self.name, self.kind)}")
        return found


def _require_file(file: str, sha256: str) -> None:
    if not isinstance(file, str) or not file or Path(file).name != file:
        raise ValueError(f"found file {file!r}, expected a file's name without a folder")
    if not isinstance(sha256, str) or not re.fullmatch(r"[0-9a-f]{64}", sha256):
        raise ValueError(f"found sha256 {sha256!r}, expected 64 hexadecimal digits")


def models_folder() -> Path:
    """Return the folder of networks: $HICKORY_MODELS, or `models` in the user's data folder."""
    named = os.environ.get("HICKORY_MODELS")
    return Path(named) if named else user_data_path("hickory-stream", appauthor=False) / "models"


def read_manifest(folder: Path) -> dict[str, ModelEntry]:
    """Return the entries of a folder by name, sorted; empty without a manifest. Raises `ModelError`."""
    path = folder / MANIFEST
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except (FileNotFoundError, NotADirectoryError):
        return {}
    except OSError as error:
        raise ModelError(f"cannot read {path}: {error.strerror}") from error
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise ModelError(f"{path} is no JSON ({error}); mend it, or remove it and add the models again") from error
    if not isinstance(data, dict) or data.get("format") != _FORMAT or not isinstance(data.get("models"), dict):
        raise ModelError(f'{path} is no manifest of models; expected {{"format": {_FORMAT}, "models": {{...}}}}')
    return {name: _entry(path, name, fields) for name, fields in sorted(data["models"].items())}


def add_model(folder: Path, file: Path, entry: ModelEntry, companions: Mapping[str, Path] | None = None) -> None:
    """Copy a network, and its companions by their roles, into a folder and write its entry; the same name is replaced.

    Raises:
        ModelError: a file's hash differs from the entry's, or the folder cannot be written.
    """
    entries = read_manifest(folder)
    given = {entry.file: file}
    if companions:
        given |= {one.file: companions[one.role] for one in entry.companions}
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, source in given.items():
            _add_file(folder / name, source, entry, entries)
        entries[entry.name] = entry
        _write_manifest(folder, entries)
    except OSError as error:
        raise ModelError(f"cannot write the model {entry.name} into {folder}: {error.strerror}") from error


def _add_file(target: Path, source: Path, entry: ModelEntry, entries: Mapping[str, ModelEntry]) -> None:
    taken = next((e.name for e in entries.values() if target.name in e.files and e.name != entry.name), None)
    if taken is not None:
        raise ModelError(f"{target} belongs to the model {taken} already; give the new file another name")
    if not (target.exists() and target.samefile(source)):
        _replace(target, lambda temporary: shutil.copyfile(source, temporary))
    if (found := sha256_of(target)) != entry.files[target.name]:
        raise ModelError(
            f"{source} has sha256 {found}, its entry says {entry.files[target.name]}; it was changed in between"
        )


def find_model(name: str, kind: Kind, *, folder: Path | None = None) -> tuple[ModelEntry, Path]:
    """Return the entry of a network and the path of its file, after checking its hash.

    Raises:
        ModelError: no network has this name and kind, or its file is missing or has another hash.
    """
    folder = folder if folder is not None else models_folder()
    entries = read_manifest(folder)
    entry = entries.get(name)
    if entry is None:
        stray = folder / f"{name}.onnx"
        if stray.is_file():
            raise ModelError(
                f"{stray} has no entry in {MANIFEST}; make one with `hickory-stream models add {stray} --kind {kind}`"
            )
        there = f"it holds {', '.join(entries)}" if entries else "it holds none"
        raise ModelError(f"no model {name} in {folder} ({there}); {how_to_get(name, kind)}")
    if entry.kind != kind:
        raise ModelError(f"the model {name} in {folder} is of kind {entry.kind}, expected {kind}")
    for file, sha256 in entry.files.items():
        _require_intact(folder / file, sha256, entry)
    return entry, folder / entry.file


def _require_intact(path: Path, sha256: str, entry: ModelEntry) -> None:
    if not path.is_file():
        raise ModelError(f"{path} is missing, though {MANIFEST} names it; {how_to_get(entry.name, entry.kind)}")
    try:
        found = sha256_of(path)
    except OSError as error:
        raise ModelError(f"cannot read {path}: {error.strerror}") from error
    if found == sha256:
        return
    is_alone = not entry.companions
    accepts = f"`hickory-stream models add {path} --kind {entry.kind} --name {entry.name}`"
    raise ModelError(
        f"{path} has sha256 {found}, {MANIFEST} says {sha256}: the file is damaged or another one; "
        + (f"export it again, or accept it with {accepts}" if is_alone else how_to_get(entry.name, entry.kind))
    )


def how_to_get(name: str, kind: Kind) -> str:
    """Return instructions to get a model of this name and kind."""
    file = "FOLDER" if kind in ("sam", "image-text") else f"{name}.onnx"
    adds = f"`hickory-stream models add {file} --kind {kind} --name {name}`"
    if kind in _GRAPHS:
        return f"add {_GRAPHS[kind]}, with {adds}"
    names = _PUBLISHED[kind]
    return f"fetch it with `hickory-stream models get {name if name in names else names[0]}`, or add yours with {adds}"


def sha256_of(path: Path) -> str:
    """Return the sha256 of a file as 64 hexadecimal digits."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def _entry(path: Path, name: str, fields: Any) -> ModelEntry:
    expected = {f.name for f in dataclasses.fields(ModelEntry)} - {"name"}
    if not isinstance(fields, dict) or not set(fields) <= expected:
        raise ModelError(f"{path}: the model {name} has other fields than {', '.join(sorted(expected))}")
    given: dict[str, Any] = {key: tuple(value) if isinstance(value, list) else value for key, value in fields.items()}
    try:
        given["companions"] = tuple(Companion(**one) for one in given.get("companions", ()))
        return ModelEntry(name=name, **given)
    except (TypeError, ValueError) as error:
        raise ModelError(f"{path}: the model {name}: {error}") from error


def _write_manifest(folder: Path, entries: dict[str, ModelEntry]) -> None:
    models = {name: dataclasses.asdict(entry) for name, entry in sorted(entries.items())}
    for fields in models.values():
        del fields["name"]
    text = dumps_exactly({"format": _FORMAT, "models": models}, indent=1) + "\n"
    _replace(folder / MANIFEST, lambda temporary: temporary.write_text(text, encoding="utf-8"))


def _replace(target: Path, write: Any) -> None:
    handle, name = tempfile.mkstemp(dir=target.parent, prefix=f".{target.name}.")
    os.close(handle)
    try:
        write(Path(name))
        Path(name).replace(target)
    finally:
        Path(name).unlink(missing_ok=True)
