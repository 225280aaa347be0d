"""The only import of Open3D: its compiled part, without the viewers that `import open3d` loads (dash, plotly, IPython).

Its wheel needs libusb, which a bare system lacks: a packaged one is loaded first.
"""

import ctypes
import sys
from importlib import import_module, util
from importlib.machinery import PathFinder
from typing import Any

from hickory_stream.errors import InputError

_COMPILED = "open3d.pybind"


def import_open3d() -> Any:
    """Return Open3D's compiled module, with `core`, `geometry` and `t`; raises `InputError` if it is not installed."""
    if _COMPILED in sys.modules:
        return sys.modules[_COMPILED]
    package = util.find_spec("open3d")
    if package is None:
        raise InputError(
            "this needs Open3D, which measures distances to surfaces, and it is not installed: "
            "pip install --upgrade hickory-stream"
        )
    try:
        import libusb_package

        ctypes.CDLL(str(libusb_package.get_library_path()), mode=ctypes.RTLD_GLOBAL)
    except (ImportError, OSError):
        pass  # the system has its own, or importing Open3D says what is missing
    # Under its full name, so that a later `import open3d` uses the same module: its types exist once in a process.
    compiled = PathFinder.find_spec(_COMPILED, package.submodule_search_locations)
    if compiled is None or compiled.loader is None:
        return import_module("open3d")
    module = util.module_from_spec(compiled)
    compiled.loader.exec_module(module)
    return sys.modules.setdefault(_COMPILED, module)
