"""A ZED camera by Stereolabs' SDK: on USB or GMSL, streamed over the network, or an SVO file.

Frames become the messages of the ROS 2 wrapper; an SVO file waits for its reader.
"""

import re
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from hickory_stream.errors import RecordingError
from hickory_stream.geometry.camera import Camera
from players.live import zed_messages as zed
from players.live.inbox import Inbox
from players.live.transport import Health, ThreadedRoute

_PORT = 30000
_AGAIN_S = 1.0
_MOST_FAILURES = 30
_NETWORK = re.compile(r"zed://(?P<host>\[[^]]+\]|[A-Za-z][^:/]*|[^:/]*\.[^:/]*)(?::(?P<port>\d+))?/?")
_CAMERA = re.compile(r"zed://(?P<serial>\d*)/?")
KNOWN = f"zed://[SERIAL], zed://IP[:{_PORT}], zed:FILE.svo2"


class _Address(NamedTuple):
    serial: int | None = None
    host: str = ""
    port: int = _PORT
    svo: Path | None = None


class ZedRoute(ThreadedRoute):
    """The `LiveSource` of `zed:`; `sl` replaces the SDK's module."""

    kind, thread_name = "ZED SDK", "zed"

    def __init__(self, uri: str, sl: Any = None) -> None:
        """Parse the address. Raises `RecordingError`: it is none, the file is missing, or the SDK is."""
        super().__init__(uri, f"{uri} was not opened yet")
        self._address = _address(uri)
        if sl is not None:
            check_sdk(sl)
        self._sl = sl if sl is not None else load_sdk()
        self._dropped = 0

    def start(self, inbox: Inbox) -> None:
        """Open the camera and grab in a separate thread, with retries."""
        for topic in zed.TOPICS:
            inbox.announce(topic)
        super().start(inbox)

    def _run(self, inbox: Inbox) -> None:
        while not self._stopped.is_set():
            camera = self._sl.Camera()
            problem = self._opened(camera)
            if problem is None:
                try:
                    problem = self._grab(camera, inbox)
                finally:
                    camera.close()
            is_over = not problem
            self._health = Health(is_connected=False, problem=problem or "the recording has ended")
            if is_over or self._address.svo is not None:
                inbox.close(f"{self.uri}: {problem}" if problem else "")
                return
            self._stopped.wait(_AGAIN_S)

    def _opened(self, camera: Any) -> str | None:
        sl, address = self._sl, self._address
        settings = sl.InitParameters()
        settings.coordinate_units = sl.UNIT.METER
        settings.coordinate_system = sl.COORDINATE_SYSTEM.IMAGE
        if address.svo is not None:
            settings.set_from_svo_file(str(address.svo))
            settings.svo_real_time_mode = False  # every frame
        elif address.host:
            settings.set_from_stream(address.host, address.port)
        elif address.serial is not None:
            settings.set_from_serial_number(address.serial)
        error = camera.open(settings)
        if error != sl.ERROR_CODE.SUCCESS:
            return f"the ZED SDK cannot open it ({_name(error)})"
        tracking = sl.PositionalTrackingParameters()
        # Without area memory poses do not jump when a loop is closed.
        tracking.enable_area_memory = False
        error = camera.enable_positional_tracking(tracking)
        if error != sl.ERROR_CODE.SUCCESS:
            camera.close()
            return f"the ZED SDK cannot track the camera ({_name(error)})"
        return None

    def _grab(self, camera: Any, inbox: Inbox) -> str:
        sl = self._sl
        runtime, color, depth, pose = sl.RuntimeParameters(), sl.Mat(), sl.Mat(), sl.Pose()
        pinhole = _pinhole(camera)
        failures, self._dropped = 0, 0
        while not self._stopped.is_set() and not inbox.is_closed:
            error = camera.grab(runtime)
            if error == sl.ERROR_CODE.END_OF_SVOFILE_REACHED:
                return ""
            if error == sl.ERROR_CODE.CORRUPTED_FRAME:
                inbox.refuse(zed.COLOR, "corrupted")
                continue
            if error != sl.ERROR_CODE.SUCCESS:
                failures += 1
                self._health = Health(is_connected=False, problem=f"no frame comes ({_name(error)})")
                if failures > _MOST_FAILURES or self._address.svo is not None:
                    return f"no frame comes ({_name(error)})"
                self._stopped.wait(0.1 if error == sl.ERROR_CODE.CAMERA_REBOOTING else 0.02)
                continue
            failures = 0
            stamp_ns = int(camera.get_timestamp(sl.TIME_REFERENCE.IMAGE).get_nanoseconds())
            state = camera.get_position(pose, sl.REFERENCE_FRAME.WORLD)
            is_tracked = state == sl.POSITIONAL_TRACKING_STATE.OK
            problem = "" if is_tracked else f"the camera is not tracked ({_name(state)}): nothing is mapped"
            self._health = Health(is_connected=True, problem=problem)
            waits = self._address.svo is not None
            if is_tracked:
                tracked = np.array(pose.pose_data(sl.Transform()).m, dtype=np.float64)
                inbox.put(zed.ODOM, zed.pose_message(stamp_ns, zed.world_from_camera(tracked)), waits=waits)
            for name in (zed.COLOR_INFO, zed.DEPTH_INFO):
                inbox.put(name, zed.info_message(stamp_ns, pinhole), waits=waits)
            camera.retrieve_image(color, sl.VIEW.LEFT)
            camera.retrieve_measure(depth, sl.MEASURE.DEPTH)
            inbox.put(zed.COLOR, zed.color_message(stamp_ns, color.get_data()), waits=waits)
            inbox.put(zed.DEPTH, zed.depth_message(stamp_ns, depth.get_data()), waits=waits)
            self._count_dropped(camera, inbox)
        return ""

    def _count_dropped(self, camera: Any, inbox: Inbox) -> None:
        number = int(camera.get_frame_dropped_count())
        if number > self._dropped:
            inbox.lost(zed.COLOR, number - self._dropped)
        self._dropped = number


def _address(uri: str) -> _Address:
    if (found := _CAMERA.fullmatch(uri)) is not None:
        return _Address(serial=int(found["serial"]) if found["serial"] else None)
    if (found := _NETWORK.fullmatch(uri)) is not None and 0 < int(found["port"] or _PORT) < 65536:
        return _Address(host=found["host"], port=int(found["port"] or _PORT))
    path = Path(uri.removeprefix("zed:"))
    if uri.startswith("zed://") or path.suffix.lower() not in (".svo", ".svo2"):
        raise RecordingError(f"found {uri}, expected {KNOWN}")
    if not path.is_file():
        raise RecordingError(f"{uri}: found no such file, expected a recording of a ZED camera (.svo2)")
    return _Address(svo=path)


def _pinhole(camera: Any) -> Camera:
    lens = camera.get_camera_information().camera_configuration.calibration_parameters.left_cam
    return Camera(
        width=int(lens.image_size.width),
        height=int(lens.image_size.height),
        fx=float(lens.fx),
        fy=float(lens.fy),
        cx=float(lens.cx),
        cy=float(lens.cy),
    )


def _name(value: Any) -> str:
    return str(getattr(value, "name", value))


# The ZED SDK's Python module, `pyzed.sl`, and the names that are used of it.
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
