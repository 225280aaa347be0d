"""The interface of writers of synthetic logs, one for each layout."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol, Self

if TYPE_CHECKING:
    from types import TracebackType

    import numpy as np
    from numpy.typing import NDArray

    from hickory_stream.geometry.camera import Camera


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class DepthView:
    """A separate depth camera: its pose in the colour camera's frame, and its delay after colour."""

    camera: Camera
    color_from_depth: NDArray[np.float64]
    lag_ns: int


class LogWriter(Protocol):
    """Writes a recording; `depth_view` is None if depth is registered to colour."""

    depth_view: DepthView | None

    def __enter__(self) -> Self:
        """Return the writer."""
        ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Finish the files."""
        ...

    def write_static(self, stamp_ns: int) -> None:
        """Write static messages."""
        ...

    def write_pose(
        self, stamp_ns: int, world_from_camera: NDArray[np.float64], velocity_link: NDArray[np.float64]
    ) -> None:
        """Write the pose of the colour camera by odometry."""
        ...

    def write_images(self, stamp_ns: int, rgb: NDArray[np.uint8], depth_m: NDArray[np.float32]) -> None:
        """Write a colour image, and the depth of the depth view."""
        ...
