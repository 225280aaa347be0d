"""A stand-in for `pyzed.sl` that plays the small scene of the players' tests; no name in it that the SDK lacks.

`PUBLISHED` is what of the SDK's Python interface (5.x, from its published stubs) may be used: names, and for methods
their parameters.
"""

import enum
from types import SimpleNamespace
import numpy as np
from tests.player_scenes import CAMERA, OPTICAL_FROM_FLU, make_scene

PUBLISHED = {
    "Camera": {
        "open": ("py_init",), "close": (), "grab": ("py_runtime",), "get_position": ("py_pose", "reference_frame"),
        "retrieve_image": ("py_mat", "view", "mem_type", "resolution"),
        "retrieve_measure": ("py_mat", "measure", "mem_type", "resolution"),
        "get_timestamp": ("time_reference",), "get_frame_dropped_count": (), "get_camera_information": ("resizer",),
        "enable_positional_tracking": ("py_tracking",), "get_sdk_version": (),
    },
    "InitParameters": {
        "set_from_serial_number": ("serial_number", "bus_type"), "set_from_stream": ("sender_ip", "port"),
        "set_from_svo_file": ("svo_input_filename",), "coordinate_units": None, "coordinate_system": None,
        "svo_real_time_mode": None,
    },
    "PositionalTrackingParameters": {"enable_area_memory": None}, "RuntimeParameters": {},
    "Mat": {"get_data": ("memory_type", "deep_copy")}, "Pose": {"pose_data": ("pose_data",)}, "Transform": {"m": None},
    "Timestamp": {"get_nanoseconds": ()},
    **{
        name: dict.fromkeys(members.split())
        for name, members in {
            "UNIT": "MILLIMETER CENTIMETER METER INCH FOOT", "COORDINATE_SYSTEM": "IMAGE RIGHT_HANDED_Z_UP_X_FWD",
            "VIEW": "LEFT RIGHT", "MEASURE": "DISPARITY DEPTH", "REFERENCE_FRAME": "WORLD CAMERA",
            "TIME_REFERENCE": "IMAGE CURRENT",
            "POSITIONAL_TRACKING_STATE": "SEARCHING OK OFF FPS_TOO_LOW UNAVAILABLE",
            "ERROR_CODE": "CORRUPTED_FRAME CAMERA_REBOOTING SUCCESS FAILURE CAMERA_NOT_DETECTED END_OF_SVOFILE_REACHED",
        }.items()
    },
}  # fmt: skip


def fake_sl(*, open_fails=0, lost_at=(), corrupted_at=-1, num_frames=6):
    """Return the module: cameras of it fail to open so many times, do not track some frames, and have a torn one."""
    sl = SimpleNamespace(**{name: enum.Enum(name, list(PUBLISHED[name])) for name in PUBLISHED if name.isupper()})
    scene = make_scene(num_frames=num_frames)
    sl.opened, fails = [], iter(range(open_fails))

    class Transform:
        m = np.eye(4)

    class Timestamp:
        def __init__(self, stamp_ns):
            self._stamp_ns = stamp_ns

        def get_nanoseconds(self):
            return self._stamp_ns

    class Mat:
        _pixels = np.zeros((0, 0))

        def get_data(self, memory_type=None, deep_copy=False):
            return self._pixels

    class Pose:
        _world_from_camera = np.eye(4)

        def pose_data(self, pose_data):
            pose_data.m = self._world_from_camera.astype(np.float32)
            return pose_data

    class InitParameters:
        coordinate_units = sl.UNIT.MILLIMETER
        coordinate_system = sl.COORDINATE_SYSTEM.IMAGE
        svo_real_time_mode = True
        _input = ()

        def set_from_serial_number(self, serial_number, bus_type=None):
            self._input = ("serial", serial_number)

        def set_from_stream(self, sender_ip, port=30000):
            self._input = ("stream", sender_ip, port)

        def set_from_svo_file(self, svo_input_filename):
            self._input = ("svo", svo_input_filename)

    class PositionalTrackingParameters:
        enable_area_memory = True

    class RuntimeParameters:
        pass

    class Camera:
        _at = -1
        _settings = None

        def open(self, py_init=None):
            if next(fails, None) is not None:
                return sl.ERROR_CODE.CAMERA_NOT_DETECTED
            self._settings = py_init
            sl.opened.append(py_init)
            return sl.ERROR_CODE.SUCCESS

        def close(self):
            self._settings = None

        def enable_positional_tracking(self, py_tracking=None):
            assert py_tracking.enable_area_memory is False
            return sl.ERROR_CODE.SUCCESS

        def grab(self, py_runtime=None):
            if self._at + 1 >= len(scene):
                return sl.ERROR_CODE.END_OF_SVOFILE_REACHED
            self._at += 1
            return sl.ERROR_CODE.CORRUPTED_FRAME if self._at == corrupted_at else sl.ERROR_CODE.SUCCESS

        def retrieve_image(self, py_mat, view, mem_type=None, resolution=None):
            # Rows of the SDK are longer than their pixels.
            rows = np.zeros((CAMERA.height, CAMERA.width + 16, 4), np.uint8)
            rows[:, : CAMERA.width, :3] = self._frame.rgb[..., ::-1]
            py_mat._pixels = rows[:, : CAMERA.width]
            return sl.ERROR_CODE.SUCCESS

        def retrieve_measure(self, py_mat, measure, mem_type=None, resolution=None):
            metres = 1.0 if self._settings.coordinate_units is sl.UNIT.METER else 1000.0
            py_mat._pixels = self._frame.depth_m * np.float32(metres)
            return sl.ERROR_CODE.SUCCESS

        def get_position(self, py_pose, reference_frame):
            if self._at in lost_at:
                return sl.POSITIONAL_TRACKING_STATE.UNAVAILABLE
            # The SDK's world: x right, y down, z ahead, from where the z-up world has its origin.
            turned = np.eye(4)
            turned[:3, :3] = OPTICAL_FROM_FLU
            py_pose._world_from_camera = turned @ self._frame.world_from_camera
            return sl.POSITIONAL_TRACKING_STATE.OK

        def get_timestamp(self, time_reference):
            return Timestamp(self._frame.stamp_ns)

        def get_frame_dropped_count(self):
            return 3 if self._at > 2 else 0

        def get_camera_information(self, resizer=None):
            size = SimpleNamespace(width=CAMERA.width, height=CAMERA.height)
            lens = SimpleNamespace(fx=CAMERA.fx, fy=CAMERA.fy, cx=CAMERA.cx, cy=CAMERA.cy, image_size=size)
            calibration = SimpleNamespace(left_cam=lens)
            return SimpleNamespace(camera_configuration=SimpleNamespace(calibration_parameters=calibration))

        @staticmethod
        def get_sdk_version():
            return "5.0.5"

        @property
        def _frame(self):
            return scene[self._at]

    for made in (
        Transform,
        Timestamp,
        Mat,
        Pose,
        InitParameters,
        PositionalTrackingParameters,
        RuntimeParameters,
        Camera,
    ):
        setattr(sl, made.__name__, made)
    return sl
