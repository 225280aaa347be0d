"""hickory-stream: posed RGB-D frames in, a map of objects with four layers out."""

from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hickory_stream.config import MapperConfig
    from hickory_stream.engine.mapper import Mapper
    from hickory_stream.errors import HickoryError
    from hickory_stream.map_folder.saved_map import SavedMap, open_map
    from hickory_stream.navigation.clearance import Answer, ClearanceScene
    from hickory_stream.navigation.free_space import free_space_of
    from hickory_stream.navigation.robot import load_robot
    from hickory_stream.navigation.search import NoPath, Path, plan
    from hickory_stream.ports import NoShape, Reconstruction, Reconstructor, ShapeInputs, Source
    from hickory_stream.query.answers import ask
    from hickory_stream.query.map_index import index_of
    from hickory_stream.records import RawFrame
    from hickory_stream.sinks.costmap_sink import CostmapSink

__all__ = [
    "Answer",
    "ClearanceScene",
    "CostmapSink",
    "HickoryError",
    "Mapper",
    "MapperConfig",
    "NoPath",
    "NoShape",
    "Path",
    "RawFrame",
    "Reconstruction",
    "Reconstructor",
    "SavedMap",
    "ShapeInputs",
    "Source",
    "__version__",
    "ask",
    "free_space_of",
    "index_of",
    "load_robot",
    "open_map",
    "plan",
]

_HOMES = {
    "hickory_stream.config": ("MapperConfig",),
    "hickory_stream.engine.mapper": ("Mapper",),
    "hickory_stream.map_folder.saved_map": ("SavedMap", "open_map"),
    "hickory_stream.errors": ("HickoryError",),
    "hickory_stream.navigation.clearance": ("Answer", "ClearanceScene"),
    "hickory_stream.navigation.free_space": ("free_space_of",),
    "hickory_stream.navigation.robot": ("load_robot",),
    "hickory_stream.navigation.search": ("NoPath", "Path", "plan"),
    "hickory_stream.ports": ("NoShape", "Reconstruction", "Reconstructor", "ShapeInputs", "Source"),
    "hickory_stream.query.answers": ("ask",),
    "hickory_stream.query.map_index": ("index_of",),
    "hickory_stream.records": ("RawFrame",),
    "hickory_stream.sinks.costmap_sink": ("CostmapSink",),
}
_HOME_OF = {name: home for home, names in _HOMES.items() for name in names}

try:
    __version__ = version("hickory-stream")
except PackageNotFoundError:  # a source tree that was never installed
    __version__ = "0+unknown"


def __getattr__(name: str) -> Any:
    # On first use, not on import: the command line must answer `--help` without loading the mapper.
    if name in _HOME_OF:
        return getattr(import_module(_HOME_OF[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
