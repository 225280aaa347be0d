"""The ZED SDK's Python module, `pyzed.sl`, and the names that are used of it."""

from importlib import import_module
from typing import Any

from hickory_stream.errors import RecordingError

USED = {
    "Camera": (
        "open",
        "close",
        "grab",
        "retrieve_image",
        "retrieve_measure",
        "get_position",
        "get_timestamp",
        "get_camera_information",
        "get_frame_dropped_count",
        "enable_positional_tracking",
        "get_sdk_version",
    ),
    "InitParameters": (
        "set_from_serial_number",
        "set_from_stream",
        "set_from_svo_file",
        "coordinate_units",
        "coordinate_system",
        "svo_real_time_mode",
    ),
    "PositionalTrackingParameters": ("enable_area_memory",),
    "RuntimeParameters": (),
    "Mat": ("get_data",),
    "Pose": ("pose_data",),
    "Transform": ("m",),
    "UNIT": ("METER",),
    "COORDINATE_SYSTEM": ("IMAGE",),
    "VIEW": ("LEFT",),
    "MEASURE": ("DEPTH",),
    "REFERENCE_FRAME": ("WORLD",),
    "TIME_REFERENCE": ("IMAGE",),
    "POSITIONAL_TRACKING_STATE": ("OK",),
    "ERROR_CODE": ("SUCCESS", "CORRUPTED_FRAME", "CAMERA_REBOOTING", "END_OF_SVOFILE_REACHED"),
}
"""Classes and what is used of each."""

_HOW = (
    "install the SDK from stereolabs.com/developers (it needs CUDA), then its Python module with its own "
    "get_python_api.py (on Linux in /usr/local/zed); the package `pyzed` of the package index is something else"
)


def load_sdk() -> Any:
    """Return the module. Raises `RecordingError`: it is not installed, or lacks a name."""
    try:
        found = import_module("pyzed.sl")
    except ImportError as error:
        raise RecordingError(f"the ZED SDK is missing ({error}): {_HOW}") from error
    check_sdk(found)
    return found


def check_sdk(sl: Any) -> None:
    """Raise `RecordingError` if the module lacks a name, e.g. in another version."""
    for owner, names in USED.items():
        for name in (None, *names):
            found = getattr(sl, owner, None)
            if found is None or (name is not None and not hasattr(found, name)):
                lacking = owner if name is None or found is None else f"{owner}.{name}"
                raise RecordingError(f"the ZED SDK that was found lacks {lacking}, expected version 5: {_HOW}")
