"""The only import of Open3D, which measuring needs: the extra `evaluation`.

Its wheel needs libusb, which a bare system lacks: a packaged one is loaded first.
"""

from __future__ import annotations

import ctypes
import importlib.util
from typing import Any

from hickory_stream.errors import InputError


def import_open3d() -> Any:
    """Return the module `open3d`; raises `InputError` if it is not installed."""
    if importlib.util.find_spec("open3d") is None:
        raise InputError(
            "this needs Open3D, which measures distances to surfaces, and it is not installed: "
            "pip install 'hickory-stream[evaluation]'"
        )
    try:
        import libusb_package

        ctypes.CDLL(str(libusb_package.get_library_path()), mode=ctypes.RTLD_GLOBAL)
    except (ImportError, OSError):
        pass  # the system has its own, or importing Open3D says what is missing
    import open3d

    return open3d
