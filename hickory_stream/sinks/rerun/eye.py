"""Initial viewpoint of the viewer: above a corner, as near as shows the whole map."""

from dataclasses import dataclass

import numpy as np
import rerun.blueprint as rrb
from numpy.typing import NDArray

from hickory_stream.geometry.display import looking, nearest_eye

# How much wider than high the views are at least, in a window of usual shape.
MAIN_ASPECT, SIDE_ASPECT, WHOLE_ASPECT = 1.15, 0.9, 1.6
# Steep enough that objects do not hide one another.
ROTATION = looking(np.deg2rad(-126.0), np.deg2rad(42.0))
# Half the viewer's own angle of view, 55 degrees from top to bottom; less a rim, for labels.
_HALF_TANGENT = float(np.tan(np.deg2rad(27.5)))
_RIM = 0.9


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Eye:
    """A position (3,) in the world, and its target (3,)."""

    position: NDArray[np.float64]
    target: NDArray[np.float64]

    def controls(self) -> rrb.EyeControls3D:
        """Return the eye for a blueprint."""
        return rrb.EyeControls3D(
            kind=rrb.Eye3DKind.Orbital, position=self.position, look_target=self.target, eye_up=(0.0, 0.0, 1.0)
        )

    def project(self, points_world: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return (N, 2) image positions of (N, 3) points, x right and y down, as fractions of the view's height."""
        local = (np.asarray(points_world) - self.position) @ ROTATION
        return np.asarray(local[:, :2] / (2 * _HALF_TANGENT * np.maximum(local[:, 2:], 1e-3)))

    def heights_m(self, points_world: NDArray[np.float64], rises: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return how far above (N, 3) points the places are that lie higher in the image by (N, K) fractions."""
        down, depth = ((np.asarray(points_world) - self.position) @ ROTATION[:, 1:]).T[..., None]
        steps = -2 * _HALF_TANGENT * rises
        return np.asarray(steps * depth / (ROTATION[2, 1] - (down / depth + steps) * ROTATION[2, 2]))


def eye_on(points_world: NDArray[np.float64], aspect: float) -> Eye:
    """Return the nearest eye with (N, 3) points in a view of `aspect` (width to height) or wider."""
    position = nearest_eye(points_world, ROTATION, (aspect * _RIM * _HALF_TANGENT, _RIM * _HALF_TANGENT))
    # What the eye turns about when it is dragged: the middle of what it sees.
    depth = float(np.mean((points_world - position) @ ROTATION[:, 2]))
    return Eye(position=position, target=position + depth * ROTATION[:, 2])
