"""The one place that imports Open3D.

Its wheel needs libusb even where no camera is, and a bare system has none: a packaged one is loaded before it.
"""

from __future__ import annotations

import ctypes
from typing import Any


def import_open3d() -> Any:
    """Return the module `open3d`."""
    try:
        import libusb_package

        ctypes.CDLL(str(libusb_package.get_library_path()), mode=ctypes.RTLD_GLOBAL)
    except (ImportError, OSError):
        pass  # the system has its own, or importing Open3D says what is missing
    import open3d

    return open3d
