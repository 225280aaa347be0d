"""Poses at which keyframes are mapped: registration to the surface of earlier keyframes."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hickory_stream.events import KeyframeKeptOut, KeyframeRegistered
from hickory_stream.geometry.camera import Camera
from hickory_stream.geometry.rigid import compose
from hickory_stream.map_folder.history.registration_history import RegistrationHistory
from hickory_stream.perception.coarse import coarse_camera, coarse_depth
from hickory_stream.poses.keyframe_registration import Belief, KeptOut, KeyframeRegistration, Remembered
from hickory_stream.poses.registration_config import RegistrationConfig
from hickory_stream.poses.surface_image import SurfaceImage, surface_image
from hickory_stream.records import Frame

# Returns with a greater sigma of depth are not used.
_MAX_DEPTH_SIGMA_M = 0.1


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class PlacedFrame:
    """A keyframe at its registered pose, and the event of the registration."""

    frame: Frame
    event: KeyframeRegistered


class RegistrationFilter:
    """Registers keyframes one after the other; frames between them get the last correction."""

    def __init__(self, config: RegistrationConfig) -> None:
        self._config = config
        self._registration = KeyframeRegistration(config)

    @property
    def map_from_odometry(self) -> NDArray[np.float64]:
        """The odometry's world in the map's, (4, 4)."""
        return self._registration.map_from_odometry

    def where(self, odometry_from_camera: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the camera's pose (4, 4) in the map, from its pose by odometry."""
        if np.array_equal(self.map_from_odometry, np.eye(4)):
            return odometry_from_camera
        return compose(self.map_from_odometry, odometry_from_camera)

    def place(self, frame: Frame, surface: SurfaceImage | None = None) -> PlacedFrame | KeyframeKeptOut | None:
        """Return a registered keyframe, or why it is rejected; None: registration is off.

        `surface` is its `keyframe_surface`, None if it was not computed.
        """
        if not self._config.enabled:
            return None
        odometry_from_camera = frame.world_from_camera
        image = keyframe_surface(frame) if surface is None else surface
        found = self._registration.place(image, odometry_from_camera, frame.degenerate)
        if isinstance(found, KeptOut):
            return KeyframeKeptOut(frame_index=frame.index, stamp_ns=frame.stamp_ns, reason=found.reason)
        is_moved = not np.array_equal(found.map_from_camera, odometry_from_camera)
        return PlacedFrame(
            frame=replace(frame, world_from_camera=found.map_from_camera) if is_moved else frame,
            event=KeyframeRegistered(
                frame_index=frame.index,
                stamp_ns=frame.stamp_ns,
                how=found.how,
                odometry_from_camera=odometry_from_camera,
                map_from_camera=found.map_from_camera,
                map_from_odometry=found.belief.map_from_odometry,
                covariance=found.belief.covariance,
                corrects=found.belief.corrects,
                num_against=found.belief.num_against,
                is_anchor=found.is_anchor,
                spread_per_m=frame.sensor.spread_per_m,
                fit=found.fit,
                degenerate=found.degenerate,
            ),
        )

    def jumped(self, *, is_loop: bool = False) -> None:
        """Record a jump of the odometry or the stamps; `is_loop`: the log begins again, and so do its poses."""
        if is_loop:
            self._registration.began_again()
        else:
            self._registration.jumped()

    def restore(self, history: RegistrationHistory | None) -> None:
        """Continue from a recorded step, None: from the beginning."""
        self._registration = KeyframeRegistration(self._config)
        if history is None:
            return
        last = history.last
        remembered = [
            Remembered(
                image=_image(np.asarray(each.coarse.depth_mm), each.camera, each.event.spread_per_m),
                map_from_camera=each.event.map_from_camera,
                number=each.number,
                is_anchor=each.event.is_anchor,
            )
            for each in history.remembered
        ]
        belief = Belief(
            map_from_odometry=last.map_from_odometry,
            covariance=last.covariance,
            corrects=last.corrects,
            num_against=last.num_against,
            odometry_from_camera=last.odometry_from_camera,
        )
        self._registration.restore(belief, remembered, history.num_placed)


def keyframe_surface(frame: Frame) -> SurfaceImage:
    """Return the surface by which a keyframe is registered; it needs nothing of the keyframes before."""
    return _image(coarse_depth(frame.depth_m), frame.camera, frame.sensor.spread_per_m)


def _image(depth_mm: NDArray[np.uint16], camera: Camera, spread_per_m: float) -> SurfaceImage:
    return surface_image(depth_mm, coarse_camera(camera), spread_per_m=spread_per_m, max_sigma_m=_MAX_DEPTH_SIGMA_M)
