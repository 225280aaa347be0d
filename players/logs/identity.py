"""Identity of a log, independent of its folder."""

from __future__ import annotations

import hashlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

_SAMPLE_BYTES = 1 << 20


def files_identity(files: Sequence[Path], sampled: Sequence[Path] | None = None) -> str:
    """Return the sha256 over name and size of all files, and the first and last MiB of the `sampled` ones (or of all).

    The folder is not included, so that a log keeps its identity when it is moved.
    """
    digest = hashlib.sha256()
    for file in files:
        digest.update(f"{file.name}\0{file.stat().st_size}\0".encode())
    for file in files if sampled is None else sampled:
        with file.open("rb") as stream:
            digest.update(stream.read(_SAMPLE_BYTES))
            stream.seek(max(_SAMPLE_BYTES, file.stat().st_size - _SAMPLE_BYTES))
            digest.update(stream.read(_SAMPLE_BYTES))
    return digest.hexdigest()
