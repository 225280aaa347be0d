"""Observations of a keyframe in the journal: the returns of each mask instead of its points.

Points are means of returns over voxels. Three returns in millimetres, each predicted from its neighbours in the image,
take less than the point that they make, which has no prediction. The points are restored to the byte.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import zstandard
from numpy.typing import NDArray

from hickory_stream.events import FrameObserved
from hickory_stream.geometry.arrays import freeze
from hickory_stream.geometry.camera import Camera
from hickory_stream.geometry.codecs.color_code import packed_colors, unpacked_colors
from hickory_stream.geometry.codecs.depth_code import packed_depths, unpacked_depths
from hickory_stream.geometry.voxels import keys_of_points
from hickory_stream.perception.observe import checksum_of, points_of_returns
from hickory_stream.records import Observation, Returns


@dataclass(frozen=True, kw_only=True, slots=True)
class PackedPoints:
    """The remainder of the `Returns` of the observation at `place`; all depths are stored together."""

    place: int
    voxel_m: float
    checksum: int
    step_px: int = 1


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class PackedFrame:
    """An event whose observations in `packed` have neither points nor colours nor returns.

    `is_used` (P,): pixels of the masks, every `step_px`-th, one mask after another, that have returns. `depths` are of
    `packed_depths`, `colors` (3, N) of `packed_colors`. Both are separate frames of zstd, since numbers of other kinds
    have other frequencies.
    """

    event: FrameObserved
    packed: tuple[PackedPoints, ...]
    is_used: NDArray[np.bool_]
    depths: bytes
    colors: bytes

    def __post_init__(self) -> None:
        freeze(self, "is_used", np.bool_, (None,))


# Masks do not overlap, but their boxes do.
_MOST_IMAGES = 64
# Next to nothing repeats: higher levels only take longer.
_LEVEL = 1
_NO_POINTS, _NO_COLORS = np.empty((0, 3), np.float32), np.empty((0, 3), np.uint8)


def packed_frame(event: FrameObserved) -> FrameObserved | PackedFrame:
    """Return an event for storage; with its points, without returns, if returns do not give the points."""
    # Only the journal uses returns: observations stored with points have none.
    observations = [one if one.returns is None else replace(one, returns=None) for one in event.observations]
    has_returns = any(one.returns is not None for one in event.observations)
    plain = replace(event, observations=tuple(observations)) if has_returns else event
    if event.coarse is None or not _are_within(event.observations, event.coarse.camera):
        return plain
    packed: list[PackedPoints] = []
    masks: list[NDArray[np.bool_]] = []
    images: list[NDArray[np.uint16]] = []
    colors: list[NDArray[np.uint8]] = []
    for place, one in enumerate(event.observations):
        # After a change of the points or the pose, returns do not give the points.
        returns = one.returns
        if returns is None or returns.checksum != checksum_of(one.points_world, event.world_from_camera):
            continue
        step = returns.step_px
        mask = one.mask[::step, ::step]
        if returns.depth_mm.shape != mask.shape or returns.depth_mm[~mask].any():
            continue
        packed.append(PackedPoints(place=place, voxel_m=returns.voxel_m, checksum=returns.checksum, step_px=step))
        masks.append(mask)
        images.append(returns.depth_mm)
        colors.append(packed_colors(keys_of_points(one.points_world, returns.voxel_m), one.colors))
        observations[place] = replace(one, points_world=_NO_POINTS, colors=_NO_COLORS, returns=None)
    if not packed:
        return plain
    return PackedFrame(
        event=replace(event, observations=tuple(observations)),
        packed=tuple(packed),
        is_used=np.concatenate([image[mask] > 0 for image, mask in zip(images, masks, strict=True)]),
        depths=zstandard.compress(packed_depths(images), _LEVEL),
        colors=zstandard.compress(np.concatenate(colors, axis=1).tobytes(), _LEVEL),
    )


def unpacked_frame(frame: PackedFrame) -> FrameObserved:
    """Return the unpacked event. Raises `ValueError`: parts do not fit, or other points result."""
    event = frame.event
    if event.coarse is None:
        raise ValueError("returns of a frame without a camera")
    places = [part.place for part in frame.packed]
    if any(a >= b for a, b in pairwise([-1, *places, len(event.observations)])):
        raise ValueError(f"returns of observations {places} of {len(event.observations)}")
    if not _are_within([event.observations[place] for place in places], event.coarse.camera):
        raise ValueError("returns of masks that do not lie in the image, or in more than it has room for")
    observations = list(event.observations)
    if any(part.step_px < 1 for part in frame.packed):
        raise ValueError("returns of no pixel")
    used = _used(frame, [event.observations[p.place].mask[:: p.step_px, :: p.step_px] for p in frame.packed])
    # A return takes a byte, or three; a point takes three bytes and comes of one return at least.
    most_bytes = 3 * sum(int(np.count_nonzero(marks)) for marks in used)
    images = unpacked_depths(_unpacked(frame.depths, most_bytes), used)
    colors_left = np.frombuffer(_unpacked(frame.colors, most_bytes), np.uint8).reshape(3, -1)
    at = 0
    for part, image in zip(frame.packed, images, strict=True):
        one = observations[part.place]
        returns = Returns(depth_mm=image, voxel_m=part.voxel_m, checksum=part.checksum, step_px=part.step_px)
        points = _points(returns, one, event.coarse.camera, event.world_from_camera)
        own = colors_left[:, at : at + len(points)]
        at += len(points)
        if own.shape[1] != len(points):
            raise ValueError(f"{colors_left.shape[1]} colours of more points")
        colors = unpacked_colors(keys_of_points(points, part.voxel_m), own)
        observations[part.place] = replace(one, points_world=points, colors=colors, returns=returns)
    if at != colors_left.shape[1]:
        raise ValueError(f"{colors_left.shape[1]} colours of {at} points")
    return replace(event, observations=tuple(observations))


def _are_within(observations: Sequence[Observation], camera: Camera) -> bool:
    # Memory for the boxes is limited to that of as many whole images.
    boxes = [one.box_px for one in observations]
    area_px = sum((x1 - x0) * (y1 - y0) for x0, y0, x1, y1 in boxes)
    is_within = all(x0 >= 0 and y0 >= 0 and x1 <= camera.width and y1 <= camera.height for x0, y0, x1, y1 in boxes)
    return is_within and area_px <= _MOST_IMAGES * camera.width * camera.height


def _used(frame: PackedFrame, masks: Sequence[NDArray[np.bool_]]) -> list[NDArray[np.bool_]]:
    ends = np.cumsum([0, *(np.count_nonzero(mask) for mask in masks)])
    if ends[-1] != len(frame.is_used):
        raise ValueError(f"marks of {len(frame.is_used)} pixels, of {ends[-1]} in masks")
    used = [np.zeros(mask.shape, dtype=bool) for mask in masks]
    for (start, end), mask, marks in zip(pairwise(ends), masks, used, strict=True):
        marks[mask] = frame.is_used[start:end]
    return used


def _unpacked(data: bytes, most_bytes: int) -> bytes:
    # The claimed size is checked before memory is taken for it.
    try:
        if not 0 <= zstandard.frame_content_size(data) <= most_bytes:
            raise ValueError(f"a frame of more than {most_bytes} bytes")
        return zstandard.decompress(data)
    except zstandard.ZstdError as error:
        raise ValueError(f"returns that cannot be unpacked: {error}") from error


def _points(
    returns: Returns, observation: Observation, camera: Camera, world_from_camera: NDArray[np.float64]
) -> NDArray[np.float32]:
    if not returns.voxel_m > 0:
        raise ValueError(f"voxels of {returns.voxel_m} m")
    points = points_of_returns(returns, observation.box_px, camera, world_from_camera)
    if checksum_of(points, world_from_camera) != returns.checksum:
        raise ValueError("the returns give other points than were seen")
    return points
