"""Object or fixture: what the observed space around a track says of how it is held, and its extent.

A fixture is attached to the room, or too large to be carried. The first is a logistic regression over signs of the
present points and space, so that it may be revised to the end; the second follows from the volume of the box.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.compiled import kernel
from hickory_stream.geometry import portable
from hickory_stream.geometry.arrays import read_only
from hickory_stream.geometry.voxels import (
    STEP_X,
    STEP_Y,
    STEP_Z,
    are_near,
    cells_of_keys,
    contains,
    difference,
    first_not_below,
    key_of_point,
    keys_of_cells,
    keys_of_points,
    layers_of_keys,
    places,
    sorted_unique,
)
from hickory_stream.mapping.entities.observed_space import SpaceState, Window, column_starts, cut, structure_of
from hickory_stream.mapping.entities.track import Track
from hickory_stream.records import ObjectKind

# Structure up to this height above the floor is the floor, on which every object stands.
_FLOOR_M = 0.1
# A thing rests on a surface within so many voxels below its feet, which are as many above its lowest voxel.
_FEET = 3
# One of the six sides of a thing at a wall is as much as can be.
_SIDES = 6.0
# Space so many voxels around the box is looked at.
_REACH = 5
# A thing whose box is as thick as this protrudes from the wall that goes on around it: depth noise, and a few frames.
_FLUSH_M = 0.15
# Too large to be carried: two people carry about 100 kg, a cubic metre of furniture weighs 20 to 70 kg, and a door is 2
# m high. The volume, and the second longest side, at which either is as likely, and their spreads as logarithms.
_CARRIED_M3, _CARRIED_SPREAD = 3.0, 0.4
_DOOR_M, _DOOR_SPREAD = 2.05, 0.08


class Signs(NamedTuple):
    """What speaks for or against an attached thing; shares from 0 to 1."""

    #: of the keyframes' votes in its voxels for structure
    structure: float
    #: of its voxels beside those of a wall or a ceiling
    attached: float
    #: of the border of its largest face where a wall goes on
    border: float
    #: the same, less with thickness
    flush: float
    #: of its feet over the floor or another thing
    rests: float
    #: of its feet over free space, where it touches a wall
    hangs: float
    #: of its surroundings at the sides that are free
    free: float
    #: how much it is an upright slab as high as a door
    slab: float


# Measured on 221 tracks of `home`, `bookstore` (walks A), an apartment and a cluttered room of ours, 25 of them walls
# or attached by the truth, each looked at every twelfth keyframe and at the end: of these looks 0.96 are right, 0.78 of
# those at fixtures. The fit is held near 4, 3, 2, 3, -1.5, 4, -1.5, 5 and -3 (standard deviations of 1.5; 1), which
# count where few tracks say anything: of what hangs, and of slabs as high as doors, which do not stand by themselves.
_WEIGHTS = Signs(structure=4.8, attached=3.0, border=1.4, flush=3.4, rests=-1.6, hangs=4.2, free=-1.4, slab=4.8)
_CONSTANT = -3.3


def judged(track: Track, space: SpaceState) -> tuple[Track, str]:
    """Return the track with its kind by the present evidence, and that in words."""
    signs, sides_m = signs_of(track, space), 2 * track.box.half_extents_m
    probability, attached = fixture_probability(signs, sides_m), attached_probability(signs)
    why = (
        f"a fixture by {probability:.2f}; {signs.attached:.0%} of it and {signs.border:.0%} of its border at a wall, "
        f"{signs.structure:.0%} of looks took it for structure, {signs.rests:.0%} of its feet rest on something, "
        f"its box is {sides_m[0]:.1f} x {sides_m[1]:.1f} x {sides_m[2]:.1f} m"
    )
    now = replace(track, kind=ObjectKind.of(probability), fixture_probability=probability, is_attached=attached > 0.5)
    return replace(now, judged_points=len(track.solid), judged_sightings=track.sightings), why


def fixture_probability(signs: Signs, sides_m: NDArray[np.float64]) -> float:
    """Return the probability that a thing is attached to the room, or too large to be carried; `sides_m` (3,)."""
    volume, middle = portable.log([sides_m.prod() / _CARRIED_M3, np.sort(sides_m)[1] / _DOOR_M])
    too_large = max(volume / _CARRIED_SPREAD, middle / _DOOR_SPREAD)
    return 1 - (1 - attached_probability(signs)) * _logistic(-too_large)


def attached_probability(signs: Signs) -> float:
    """Return the probability that a thing is attached to the room."""
    return _logistic(_CONSTANT + sum(weight * sign for weight, sign in zip(_WEIGHTS, signs, strict=True)))


def signs_of(track: Track, space: SpaceState) -> Signs:
    """Return the signs of a track in the observed space around it."""
    space = cut(space, _window_around(track, space.voxel_m))
    keys = sorted_unique(keys_of_points(track.solid.points, space.voxel_m))
    cells, walls = cells_of_keys(keys), _walls(track, space)
    known = keys[contains(space.surface, keys)]
    at = places(space.surface, known)
    hits, misses = int(space.hits[at].sum(dtype=np.int64)), int(space.misses[at].sum(dtype=np.int64))
    half = track.box.half_extents_m
    thin = int(np.argmin(half))
    thick_m, high_m = 2 * float(half[thin]), 2 * float(half[2])
    attached = float(are_near(walls, keys).mean())
    border = float(_found_around(track, walls, space.voxel_m, thin).any(axis=1).mean())
    rests, hangs = _held(keys, cells, walls, space)
    upright = 1.0 - abs(float(track.box.world_from_box[2, thin]))
    return Signs(
        structure=hits / max(hits + misses, 1),
        attached=attached,
        border=border,
        flush=border * float(portable.exp(-thick_m / _FLUSH_M)),
        rests=rests,
        hangs=hangs * min(_SIDES * max(attached, border), 1.0),
        free=float(_found_around(track, space.free, space.voxel_m, 2).mean()),
        slab=upright * max(0.0, 1.0 - thick_m / 0.25) * min(high_m / 2.0, 1.0),
    )


def _window_around(track: Track, voxel_m: float) -> Window:
    corners = track.box.corners_world()[:, :2] / voxel_m
    (x0, y0), (x1, y1) = np.floor(corners.min(axis=0)).astype(int), np.floor(corners.max(axis=0)).astype(int)
    return Window((int(x0), int(y0)), (int(x1) + 1, int(y1) + 1)).wider(_REACH)


def _walls(track: Track, space: SpaceState) -> NDArray[np.int64]:
    # Structure without the floor, and without other ground: level structure lower than the middle of the track.
    structure = structure_of(space)
    height_m = (layers_of_keys(structure) + 0.5) * space.voxel_m
    is_covered = contains(structure, structure + STEP_Z)
    floor_m = -np.inf if space.floor_z_m is None else space.floor_z_m + _FLOOR_M
    return structure[(height_m > floor_m) & (is_covered | (height_m > track.box.center[2]))]


def _held(
    keys: NDArray[np.int64], cells: NDArray[np.int64], walls: NDArray[np.int64], space: SpaceState
) -> tuple[float, float]:
    # The shares of its feet, the lowest voxels of its low columns, over or beside a surface, and over nothing.
    feet = cells[column_starts(cells)]
    feet = feet[feet[:, 2] < feet[:, 2].min() + _FEET]
    at = keys_of_cells(feet)
    below = [at - down * STEP_Z for down in range(1, _FEET + 1)]
    beside = [at + step for step in (STEP_X, -STEP_X, STEP_Y, -STEP_Y)]
    others = difference(difference(space.surface, walls), keys)
    rests = np.any([contains(others, place) for place in (*below, *beside)], axis=0)
    hangs = np.any([contains(space.free, place) for place in below], axis=0) & ~rests
    return float(rests.mean()), float(hangs.mean())


def _found_around(track: Track, voxels: NDArray[np.int64], voxel_m: float, axis: int) -> NDArray[np.bool_]:
    # (R, D) which places around the box, R across an axis and D along it, are in some sorted voxels.
    half = track.box.half_extents_m + 1.5 * voxel_m
    return np.asarray(_around(read_only(voxels), half, read_only(track.box.world_from_box), axis, voxel_m))


@kernel
def _around(voxels, half, pose, axis, voxel_m):
    along, first, second = half[axis], 1 if axis == 0 else 0, 1 if axis == 2 else 2
    num_first, num_second = np.int64(2 * half[first] / voxel_m) + 2, np.int64(2 * half[second] / voxel_m) + 2
    count = np.int64(2 * along / voxel_m) + 2
    out = np.empty((2 * (num_first + num_second) - 4, count), np.bool_)
    place, n, at = np.empty(3), 0, np.int64(0)
    for i in range(num_first):
        for j in range(num_second):
            if 0 < i < num_first - 1 and 0 < j < num_second - 1:
                continue
            place[first], place[second] = _on_line(half[first], i, num_first), _on_line(half[second], j, num_second)
            for k in range(count):
                place[axis] = _on_line(along, k, count)
                x = place[0] * pose[0, 0] + place[1] * pose[0, 1] + place[2] * pose[0, 2] + pose[0, 3]
                y = place[0] * pose[1, 0] + place[1] * pose[1, 1] + place[2] * pose[1, 2] + pose[1, 3]
                z = place[0] * pose[2, 0] + place[1] * pose[2, 1] + place[2] * pose[2, 2] + pose[2, 3]
                key = key_of_point(x, y, z, voxel_m)
                at = first_not_below(voxels, key, at)
                out[n, k] = at < len(voxels) and voxels[at] == key
            n += 1
    return out


@kernel
def _on_line(half, i, count):
    # Place i of so many evenly from -half to half.
    return half if i == count - 1 else i * (2 * half / (count - 1)) - half


def _logistic(odds: float) -> float:
    return 1 / (1 + float(portable.exp(-odds)))
