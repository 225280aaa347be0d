"""Cache of shapes by their input: a second playback of a log reconstructs nothing.

The key is a hash of the job's input, our code that builds shapes, library versions, and the kind of processor if
shapes depend on it.
"""

import hashlib
import logging
import os
import shutil
import sys
from contextlib import suppress
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from hickory_stream.base.caches import mark_used
from hickory_stream.engine.shape_jobs.job_folder import MESH, RESULT
from hickory_stream.engine.shape_jobs.processor import processor_of_shapes

logger = logging.getLogger(__name__)

_ANSWER = (MESH, RESULT)
_CODE = ("shapes", "geometry", "engine/shape_jobs/generators")
_LIBRARIES = ("numpy", "scipy", "numba", "scikit-image", "trimesh")


class ShapeCache:
    """A folder of answers by the hash of their jobs; errors of the disk are misses.

    `made_by` is the hash of a generator's program and weights, "" without one.
    """

    def __init__(self, folder: Path, made_by: str = "") -> None:
        self._folder = folder
        self._made_by = made_by

    def key(self, job: Path) -> str:
        """Return the hash of a job's input and of the code that answers it."""
        digest = hashlib.sha256(f"{_environment()} {MESH} {self._made_by}".encode())
        for path in sorted(job.iterdir()):
            if path.name not in _ANSWER:
                content = path.read_bytes()
                digest.update(f"{path.name}:{len(content)}:".encode())
                digest.update(content)
        return digest.hexdigest()

    def fetch(self, key: str, job: Path) -> bool:
        """Copy a known answer into a job's folder; return whether there was one."""
        entry = self._folder / key[:2] / key
        try:
            if not (entry / RESULT).is_file():
                return False
            for path in entry.iterdir():
                shutil.copyfile(path, job / path.name)
            mark_used(entry)
        except OSError as error:
            logger.debug("shape cache: %s", error)
            (job / RESULT).unlink(missing_ok=True)
            return False
        return True

    def store(self, key: str, job: Path) -> None:
        """Store the answer of a job."""
        entry = self._folder / key[:2] / key
        partial = entry.with_name(f".{key}.{os.getpid()}")
        try:
            if entry.exists():
                return
            partial.mkdir(parents=True)
            for name in _ANSWER:
                if (job / name).exists():
                    shutil.copyfile(job / name, partial / name)
            partial.rename(entry)
        except OSError as error:
            logger.debug("shape cache: %s", error)
            shutil.rmtree(partial, ignore_errors=True)


@cache
def _environment() -> str:
    root = Path(__file__).resolve().parents[2]
    digest = hashlib.sha256()
    for package in _CODE:
        for path in sorted((root / package).rglob("*.py")):
            digest.update(path.relative_to(root).as_posix().encode() + path.read_bytes())
    libraries = []
    for name in _LIBRARIES:
        with suppress(PackageNotFoundError):
            libraries.append(f"{name} {version(name)}")
    return f"{digest.hexdigest()} {sys.version_info[:2]} {' '.join(libraries)} {processor_of_shapes()}"
