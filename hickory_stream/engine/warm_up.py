"""Warm-up of numba kernels, which takes a minute, before the first job.

As a program (`python -m hickory_stream.engine.warm_up PART`) it prints compiled kernels as lines of JSON for
`first_run`.
"""

import contextlib
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from hickory_stream.base.compiled import kernels_folder
from hickory_stream.base.compiling import on_compile
from hickory_stream.base.json_text import dumps
from hickory_stream.box_scene import SCENE_BOXES, SceneBox, SceneSource, shape_inputs
from hickory_stream.config import MapperConfig
from hickory_stream.engine.keyframe_places import RegistrationFilter
from hickory_stream.events import ComputeFeatures, Effect
from hickory_stream.geometry.mesh import Mesh
from hickory_stream.journal.checkpoints import Packer
from hickory_stream.journal.packed_frames import PackedFrame, packed_frame, unpacked_frame
from hickory_stream.journal.record_codec import decode, encode
from hickory_stream.mapping.core import MapperCore
from hickory_stream.perception.choose import make_segmenter
from hickory_stream.perception.descriptor import ColorTextureDescriptor
from hickory_stream.perception.observe import MILLIMETRE
from hickory_stream.perception.perceive import features_of, perceive
from hickory_stream.ports import FeatureExtractor, Segmenter
from hickory_stream.shapes.build import ShapeConfig, build_shape
from hickory_stream.shapes.fit.marching_primitives import FitConfig, fitted_shape
from hickory_stream.shapes.reconstruct.fused import FusedConfig, FusedReconstructor, VolumeConfig

# A stool with a back: several primitives, some of them thin.
_STOOL = (
    SceneBox(low=(-0.2, -0.2, 0.3), high=(0.2, 0.2, 0.36), rgb=(150, 100, 60)),
    SceneBox(low=(-0.05, -0.05, 0.0), high=(0.05, 0.05, 0.3), rgb=(120, 80, 50)),
    SceneBox(low=(-0.2, 0.14, 0.36), high=(0.2, 0.2, 0.7), rgb=(160, 110, 70)),
)
_FRAMES = (0, 9, 18, 27)
_WALL = SceneBox(low=(-3.0, 1.6, 0.0), high=(3.0, 1.8, 2.4), rgb=(220, 220, 210))
_NUM_MAPPED = 12
_NUM_REHEARSED = 3
_COARSE = ShapeConfig(
    fused=FusedConfig(volume=VolumeConfig(cells=20)),
    fit=FitConfig(cells=20, coarse_samples=200, fine_samples=400, gain_samples=1000, joint_samples=500),
)


def warm_up() -> None:
    """Build two small shapes, to compile or load their kernels; of several processes one compiles."""
    with _one_at_a_time("shapes"):
        build_shape(shape_inputs(_STOOL, _FRAMES), FusedReconstructor(_COARSE.fused), _COARSE)
        fitted_shape(_pipe(), _COARSE.fit)


def warm_up_mapping() -> None:
    """Map a few frames, to compile or load the kernels of perception, core and journal."""
    config = MapperConfig()
    with _one_at_a_time("mapping"):
        rehearse(make_segmenter(config.perception), ColorTextureDescriptor(), config, num_frames=_NUM_MAPPED)


def rehearse(
    segmenter: Segmenter, extractor: FeatureExtractor, config: MapperConfig, *, num_frames: int = _NUM_REHEARSED
) -> None:
    """Map the first frames of a small scene, to load kernels and run networks once.

    Otherwise the first keyframe of a process takes a second longer.
    """
    core, places = MapperCore(config.mapping), RegistrationFilter(config.registration)
    for raw in SceneSource(num_frames, (*SCENE_BOXES, _WALL)).frames():
        frame = raw.decode()
        # Depth as cameras give it, of which the journal has the returns.
        frame = replace(frame, depth_m=np.rint(frame.depth_m * np.float32(1000)) * MILLIMETRE)
        places.place(frame)
        prepared, prior = segmenter.prepare(frame), core.prior()
        perceived = perceive(frame, prior, prepared, segmenter, config.perception, lattice=config.mapping.voxels)
        event = perceived.event(frame)
        waiting: list[Effect] = core.handle(event)
        while waiting:
            effect = waiting.pop(0)
            if isinstance(effect, ComputeFeatures):
                patches = extractor.extract(np.asarray(frame.rgb))
                waiting += core.handle(features_of(effect, perceived.observations, patches, extractor.patch_px))
        stored = decode(encode(packed_frame(event)))
        if isinstance(stored, PackedFrame):
            unpacked_frame(stored)
    encode(Packer().packed(core.state()))


PARTS: dict[str, Callable[[], None]] = {"mapping": warm_up_mapping, "shapes": warm_up}


def main(part: str) -> None:
    """Compile and report the kernels of a part."""
    on_compile(_say)
    PARTS[part]()


def _say(kernel: str) -> None:
    sys.stdout.write(dumps({"kernel": kernel}) + "\n")
    sys.stdout.flush()


def _pipe() -> Mesh:
    # Thin and hollow, which the stool is not.
    square = ((1, 1), (-1, 1), (-1, -1), (1, -1))
    corners = np.array([(x * r, y * r, z) for z in (0, 1) for r in (0.49, 0.5) for x, y in square])
    faces = []
    for i in range(4):
        j = (i + 1) % 4
        rings = (
            (4 + i, 4 + j, 12 + j, 12 + i),
            (i, 8 + i, 8 + j, j),
            (i, j, 4 + j, 4 + i),
            (8 + i, 12 + i, 12 + j, 8 + j),
        )
        faces += [triangle for a, b, c, d in rings for triangle in ((a, b, c), (a, c, d))]
    return Mesh(
        vertices=corners.astype(np.float32),
        faces=np.array(faces, np.int32),
        colors=np.zeros((16, 3), np.uint8),
        is_seen=np.ones(16, bool),
    )


@contextlib.contextmanager
def _one_at_a_time(part: str) -> Iterator[None]:
    # Without a lock file every process compiles.
    with contextlib.ExitStack() as held:
        if sys.platform != "win32":
            import fcntl

            with contextlib.suppress(OSError):
                path = kernels_folder() / f"{part}.lock"
                path.parent.mkdir(parents=True, exist_ok=True)
                fcntl.flock(held.enter_context(path.open("w")), fcntl.LOCK_EX)
        yield


if __name__ == "__main__":
    main(sys.argv[1])
