"""hickory-stream: posed RGB-D frames in, a map of objects with four layers out."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hickory_stream.config import MapperConfig
    from hickory_stream.engine.mapper import Mapper

__all__ = ["Mapper", "MapperConfig", "__version__"]

try:
    __version__ = version("hickory-stream")
except PackageNotFoundError:  # a source tree that was never installed
    __version__ = "0+unknown"


def __getattr__(name: str) -> Any:
    # On first use, not on import: the command line must answer `--help` without loading the mapper.
    if name == "Mapper":
        from hickory_stream.engine.mapper import Mapper

        return Mapper
    if name == "MapperConfig":
        from hickory_stream.config import MapperConfig

        return MapperConfig
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
