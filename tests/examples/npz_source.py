"""Example of a source: posed RGB-D frames from a NumPy archive."""

import hashlib
from functools import partial
from zipfile import BadZipFile
import numpy as np
from hickory_stream.errors import RecordingError
from hickory_stream.geometry.camera import Camera
from hickory_stream.records import Frame, RawFrame, SourceInfo

ARRAYS = ("rgb", "depth_m", "stamps_ns", "world_from_camera", "intrinsics")


class NpzSource:
    """Plays `rgb` (N, H, W, 3), `depth_m` (N, H, W), `stamps_ns` (N,), `world_from_camera` (N, 4, 4), `intrinsics`."""

    def __init__(self, path):
        try:
            with path.open("rb") as file, np.load(file) as archive:
                self._rgb, self._depth_m, self._stamps_ns, self._poses, lens = (archive[name] for name in ARRAYS)
        except (OSError, ValueError, KeyError, BadZipFile) as error:
            raise RecordingError(f"{path} is no log of frames ({error}); expected the arrays {ARRAYS}") from error
        height, width = self._rgb.shape[1:3]
        self._num_yielded = 0
        self.info = SourceInfo(
            uri=str(path), kind="NumPy archive", identity=hashlib.sha256(path.read_bytes()).hexdigest(),
            camera=Camera(width=width, height=height, fx=lens[0], fy=lens[1], cx=lens[2], cy=lens[3]),
            num_frames=len(self._stamps_ns), start_ns=int(self._stamps_ns[0]), end_ns=int(self._stamps_ns[-1]),
            streams=(("color", "rgb"), ("depth", "depth_m"), ("pose", "world_from_camera")),
        )  # fmt: skip

    def frames(self):
        """Yield the frames from the beginning."""
        for i, (stamp_ns, pose) in enumerate(zip(self._stamps_ns.tolist(), self._poses, strict=True)):
            self._num_yielded = i + 1
            known = {"index": i, "stamp_ns": stamp_ns, "world_from_camera": pose, "camera": self.info.camera}
            yield RawFrame(**known, decode=partial(Frame, **known, rgb=self._rgb[i], depth_m=self._depth_m[i]))

    def ledger(self):
        """Return how many frames the latest pass has yielded."""
        return {"frames": self._num_yielded}

    def close(self):
        """Do nothing: the arrays are in memory."""
