"""Kernels are compiled by the first call there ever is, which takes a minute: here, so that it is in nobody's job."""

from __future__ import annotations

import contextlib
import os
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.geometry.boxes import gravity_aligned_box
from hickory_stream.geometry.camera import backproject
from hickory_stream.geometry.rigid import apply
from hickory_stream.ports import Crop, ShapeInputs
from hickory_stream.shapes.build import ShapeConfig, build_shape
from hickory_stream.shapes.fit import FitConfig
from hickory_stream.shapes.fused import FusedConfig, FusedReconstructor, VolumeConfig
from hickory_stream.testing import SCENE_CAMERA, SceneBox, cast_scene, scene_pose

if TYPE_CHECKING:
    from collections.abc import Iterator

# A stool with a back: several primitives, some of them thin.
_STOOL = (
    SceneBox(low=(-0.2, -0.2, 0.3), high=(0.2, 0.2, 0.36), rgb=(150, 100, 60)),
    SceneBox(low=(-0.05, -0.05, 0.0), high=(0.05, 0.05, 0.3), rgb=(120, 80, 50)),
    SceneBox(low=(-0.2, 0.14, 0.36), high=(0.2, 0.2, 0.7), rgb=(160, 110, 70)),
)
_FRAMES = (0, 9, 18, 27)
_COARSE = ShapeConfig(
    fused=FusedConfig(volume=VolumeConfig(cells=20)),
    fit=FitConfig(cells=20, coarse_samples=200, fine_samples=400, gain_samples=1000, joint_samples=500),
)


def warm_up() -> None:
    """Build one small shape, so that every kernel of it is compiled, and cached on disk, or loaded from there.

    Of several processes one compiles; the others wait for it, and load.
    """
    with _one_at_a_time():
        build_shape(_inputs(), FusedReconstructor(_COARSE.fused), _COARSE)


def _inputs() -> ShapeInputs:
    crops = []
    for index in _FRAMES:
        pose = scene_pose(index)
        rgb, depth_m, instances = cast_scene(_STOOL, SCENE_CAMERA, pose)
        crops.append(Crop(rgb=rgb, depth_m=depth_m, mask=instances > 0, camera=SCENE_CAMERA, world_from_camera=pose))
    points = np.concatenate(
        [apply(crop.world_from_camera, backproject(crop.depth_m, crop.camera)[crop.mask]) for crop in crops]
    )
    return ShapeInputs(
        crops=tuple(crops),
        points_world=points.astype(np.float32),
        colors=np.concatenate([crop.rgb[crop.mask] for crop in crops]),
        box=gravity_aligned_box(points, 0.005),
        support_z_m=0.0,
    )


@contextlib.contextmanager
def _one_at_a_time() -> Iterator[None]:
    """Hold a lock of this user on this machine; where there can be none everybody compiles."""
    with contextlib.ExitStack() as held:
        if sys.platform != "win32":
            import fcntl

            with contextlib.suppress(OSError):
                path = Path(tempfile.gettempdir()) / f"hickory-stream-compile-{os.getuid()}.lock"
                fcntl.flock(held.enter_context(path.open("w")), fcntl.LOCK_EX)
        yield
