"""Submaps: parts of the map that can be moved rigidly, each with its share of the observed space.

All data stay in the frame of the odometry: a correction only sets the pose of each submap, applied when the map is
published. A submap ends when the odometry may have drifted by a few centimetres, jumped, or changed storey. Checks use
everything seen since the last jump in submaps *rigid with the open one*, i.e. with the same corrected pose.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.ranges import Ranged, number
from hickory_stream.events import FrameObserved, KeyframeRegistered
from hickory_stream.geometry import portable
from hickory_stream.geometry.arrays import freeze
from hickory_stream.geometry.lazy_arrays import Keep, compress, give_up, in_memory, read_briefly
from hickory_stream.geometry.rigid import compose, invert, rotation_angle_rad, turned_directions
from hickory_stream.geometry.voxels import difference, places, union
from hickory_stream.mapping.entities import observed_space
from hickory_stream.mapping.entities.observed_space import (
    SURE_HITS,
    SpaceState,
    Window,
    added,
    as_record,
    cut,
    empty_space,
    extent,
    is_another_storey,
    window_of,
    without_floor,
)
from hickory_stream.mapping.entities.submap_surface import SubmapSurface, no_surface, surface_points, with_points
from hickory_stream.records import (
    OPEN_JUMP_M,
    OPEN_JUMP_RAD,
    Keypoints,
    ObservedSpace,
    SpaceObservation,
    SurveyedSubmap,
)


def longer(
    lengths: NDArray[np.float64] | None,
    directions: NDArray[np.float64],
    before: NDArray[np.float64] | None,
    now: NDArray[np.float64],
) -> NDArray[np.float64] | None:
    """Return a path's unobserved lengths (6, 6) after a step between camera poses (4, 4), blind along (K, 6).

    Lengths are sums over steps of (direction x direction) x length: turns (rad), then shifts (m), along the map's axes.
    Their product with a direction is the length along it. None: no length.
    """
    if before is None or not len(directions):
        return lengths
    way_m = portable.norm(now[:3, 3] - before[:3, 3])
    turn_rad = rotation_angle_rad(portable.matmul(before[:3, :3].T, now[:3, :3]))
    root = np.sqrt([turn_rad] * 3 + [way_m] * 3) * directions
    step = portable.matmul(root.T, root)
    return step if lengths is None else lengths + step


_SURE_NORMAL = 0.8
_NO_POINTS, _NO_KEYS = np.empty((0, 3), np.float32), np.empty(0, np.int64)
# The window reaches at least so far around what a keyframe sees: further than any check of a track looks, and than the
# next keyframe may look beside it. Where it is moved it reaches further by the second length.
LEAST_BESIDE_M = 4.0
_MOST_BESIDE_M = 8.0
# The odometry's drift within a submap: a share of the path, and a length for each radian that the camera turned.
_DRIFT_SHARE = 0.01
_DRIFT_PER_RAD_M = 0.005
# Sigma across a jump of the odometry, by the jump's size and by the time over which motion was predicted.
_JUMP_SHARE = 0.5
_PREDICTED_MPS, _PREDICTED_RADPS = 0.3, 0.15
# The voxel size of a submap's surface, in which loops are searched, and the greatest depth of its points.
_SURFACE_M = 0.08
_SURFACE_RANGE_M = 5.0
# A keyframe's features are kept if no other one of its submap looked from so near in so nearly the same direction.
_SAME_VIEW_M, _SAME_VIEW_COSINE = 0.25, 0.966


@dataclass(frozen=True, kw_only=True, slots=True)
class SubmapConfig(Ranged):
    """When a submap ends, besides jumps of the odometry."""

    #: Length of the camera's path after which a submap ends.
    travel_m: float = number(15.0, 0.01, 1e6, "m")
    #: Drift that the odometry may have gathered in a submap before it ends.
    drift_m: float = number(0.06, 0.001, 1e6, "m")
    #: Whether a submap that has ended is searched in those before it.
    searches_loops: bool = True
    #: The result of a search takes effect at the first keyframe this long after the submap's end.
    loop_latency_s: float = number(3.0, 0, 3600, "s")


@dataclass(frozen=True, kw_only=True, slots=True, eq=False, weakref_slot=True)
class SubmapState:
    """A submap; all its data are in the odometry frame, which `world_from_submap` places in the world."""

    id: int
    world_from_submap: NDArray[np.float64]
    #: voxels that this submap saw first: its share while no correction has moved any submap
    space: SpaceState
    #: all voxels that were seen in this submap: its share once a correction has moved any
    seen: SpaceState
    began_ns: int | None = None
    #: camera pose (4, 4) of its first keyframe
    anchor: NDArray[np.float64] | None = None
    way_m: float = 0.0
    turn_rad: float = 0.0
    after_jump: bool = False
    #: sigmas of its place and turn after the jump
    jump_m: float = OPEN_JUMP_M
    jump_rad: float = OPEN_JUMP_RAD
    #: covariance (6, 6) of its least certain keyframe; None if `is_loose`
    registered: NDArray[np.float64] | None = None
    #: one of its keyframes is not registered: the odometry alone places it
    is_loose: bool = False
    #: lengths (6, 6) along which the odometry saw nothing (`longer`)
    blind: NDArray[np.float64] | None = None
    #: lengths (6, 6) along which registration saw nothing
    unfixed: NDArray[np.float64] | None = None
    surface: SubmapSurface = field(default_factory=no_surface)
    keypoints: tuple[Keypoints, ...] = ()
    #: sorted voxels that a later submap contradicts (`space_agreement`); None without a correction
    outdated: NDArray[np.int64] | None = None

    def __post_init__(self) -> None:
        freeze(self, "world_from_submap", np.float64, (4, 4))
        if self.outdated is not None:
            freeze(self, "outdated", np.int64, (None,))
        if self.anchor is not None:
            freeze(self, "anchor", np.float64, (4, 4))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False, weakref_slot=True)
class Submaps:
    """All submaps, the last of which is open, and the `space` against which tracks are checked."""

    states: tuple[SubmapState, ...]
    #: the space of the submaps from `first` on, within `window`
    space: SpaceState
    #: the first submap of the last ones that are rigid with the open one
    first: int = 0
    #: the first submap after the last jump of the odometry
    since_jump: int = 0
    #: sorted keys (N,) of the voxels of the closed ones of them
    owned: NDArray[np.int64]
    #: id (N,) of the submap that owns each
    owners: NDArray[np.int32]
    #: the surroundings of the present view; None: everything
    window: Window | None = None
    #: camera pose (4, 4) of the last keyframe; None before it and after a jump
    last_pose: NDArray[np.float64] | None = None

    def __post_init__(self) -> None:
        freeze(self, "owned", np.int64, (None,))
        freeze(self, "owners", np.int32, (len(self.owned),))
        if self.last_pose is not None:
            freeze(self, "last_pose", np.float64, (4, 4))

    @property
    def open_id(self) -> int:
        """The id of the open submap."""
        return len(self.states) - 1

    def world_from(self, submap_id: int) -> NDArray[np.float64]:
        """Return the pose of a submap: world_from_submap (4, 4)."""
        return self.states[submap_id].world_from_submap

    def is_rigid_with_open(self, submap_id: int) -> bool:
        """Return whether a submap has the pose of the open one, so that its data lie where the odometry has them."""
        return _is_same_place(self.states[submap_id], self.states[-1])

    def open_from(self, submap_id: int) -> NDArray[np.float64]:
        """Return the pose of a submap in the frame of the open one, the frame of new keyframes: (4, 4)."""
        return self.between(self.open_id, submap_id)

    def between(self, a: int, b: int) -> NDArray[np.float64]:
        """Return the pose of a submap b in the frame of another one: a_from_b (4, 4)."""
        a_place, b_place = self.states[a].world_from_submap, self.states[b].world_from_submap
        return np.eye(4) if a_place is b_place else compose(invert(a_place), b_place)


def first_submap(voxel_m: float) -> Submaps:
    """Return one open, empty submap."""
    space = empty_space(voxel_m)
    state = SubmapState(id=0, world_from_submap=np.eye(4), space=space, seen=space)
    return Submaps(states=(state,), space=space, owned=np.empty(0, np.int64), owners=np.empty(0, np.int32))


def with_keyframe(submaps: Submaps, event: FrameObserved, config: SubmapConfig) -> Submaps:
    """Return the submaps after a keyframe, with its surface added to the open one."""
    pose = event.world_from_camera
    blind = longer(submaps.states[-1].blind, turned_directions(pose, event.degenerate), submaps.last_pose, pose)
    submaps = travelled(_with_open(submaps, blind=blind), pose, event.stamp_ns, config)
    views = submaps.states[-1].keypoints
    if event.keypoints is not None and not any(_is_same_view(view.world_from_camera, pose) for view in views):
        submaps = _with_open(submaps, keypoints=(*views, event.keypoints))
    if event.coarse is None:
        return submaps
    seen = surface_points(event.coarse, pose, _SURFACE_RANGE_M)
    return _with_open(submaps, surface=with_points(submaps.states[-1].surface, seen, _SURFACE_M))


def _is_same_view(a: NDArray[np.float64], b: NDArray[np.float64]) -> bool:
    return portable.norm(a[:3, 3] - b[:3, 3]) < _SAME_VIEW_M and portable.dot(a[:3, 2], b[:3, 2]) > _SAME_VIEW_COSINE


def travelled(submaps: Submaps, pose: NDArray[np.float64], stamp_ns: int, config: SubmapConfig) -> Submaps:
    """Return the submaps after the camera has moved to a pose (4, 4); a new one is opened where the old one ends."""
    last, current = submaps.last_pose, submaps.states[-1]
    if last is not None:
        way_m = current.way_m + portable.norm(pose[:3, 3] - last[:3, 3])
        turn_rad = current.turn_rad + rotation_angle_rad(portable.matmul(last[:3, :3].T, pose[:3, :3]))
        submaps = _with_open(submaps, way_m=way_m, turn_rad=turn_rad)
        drift_m = _DRIFT_SHARE * way_m + _DRIFT_PER_RAD_M * turn_rad
        if way_m >= config.travel_m or drift_m >= config.drift_m:
            submaps = _opened(_closed(submaps))
    if submaps.states[-1].anchor is None:
        submaps = _with_open(submaps, anchor=pose, began_ns=stamp_ns)
    return replace(submaps, last_pose=pose)


def with_registration(submaps: Submaps, event: KeyframeRegistered) -> Submaps:
    """Return the submaps after the registration of a keyframe, successful or not."""
    current = submaps.states[-1]
    if current.is_loose:
        return submaps
    if not event.corrects:
        return _with_open(submaps, registered=None, unfixed=None, is_loose=True)
    least = event.covariance
    if current.registered is not None and current.registered.diagonal()[3:].sum() >= least.diagonal()[3:].sum():
        least = current.registered
    unfixed = longer(current.unfixed, event.degenerate, submaps.last_pose, event.map_from_camera)
    return _with_open(submaps, registered=least, unfixed=unfixed)


def interrupted(submaps: Submaps) -> Submaps:
    """Return the submaps after a jump of the stamps: the step across it does not count as path."""
    return replace(submaps, last_pose=None)


def after_pose_jump(submaps: Submaps, after_from_before: NDArray[np.float64], gap_s: float) -> Submaps:
    """Return the submaps after a jump of the odometry: with a new one, unless the open one has no keyframe.

    `gap_s`: time since the last keyframe, in which the odometry was predicted; the identity is a jump of unknown size.
    """
    if submaps.states[-1].anchor is None:
        return submaps
    sigmas = {}
    if submaps.last_pose is not None and not np.array_equal(after_from_before, np.eye(4)):
        # A loop closure of the odometry leaves the prediction right. Where a lost track was found, all of the jump is
        # missing in it.
        moved = compose(invert(submaps.last_pose), after_from_before, submaps.last_pose)
        jump_m = _JUMP_SHARE * portable.norm(moved[:3, 3]) + _PREDICTED_MPS * gap_s
        jump_rad = _JUMP_SHARE * rotation_angle_rad(moved[:3, :3]) + _PREDICTED_RADPS * gap_s
        sigmas = {"jump_m": min(jump_m, OPEN_JUMP_M), "jump_rad": min(jump_rad, OPEN_JUMP_RAD)}
    space, after = empty_space(submaps.space.voxel_m), submaps.open_id + 1
    submaps = replace(submaps, space=space, window=None, first=after, since_jump=after, last_pose=None)
    submaps = replace(submaps, owned=_NO_KEYS, owners=np.empty(0, np.int32))
    return _with_open(_opened(submaps), after_jump=True, **sigmas)


def looking_at(submaps: Submaps, seen: SpaceObservation, keep: Keep = in_memory) -> Submaps:
    """Return the submaps with the space of a window around a view; `keep` gets the compressed rest."""
    sight = window_of(seen.free_keys, seen.structure_keys, seen.surface_keys)
    if submaps.first == submaps.open_id or sight is None:
        return submaps
    voxel_m = submaps.space.voxel_m
    least = sight.wider(round(LEAST_BESIDE_M / voxel_m))
    if submaps.window is not None and submaps.window.holds(least):
        return submaps
    moved = _within(submaps, least.wider(round(_MOST_BESIDE_M / voxel_m)))
    compress_unused(moved, keep)
    return moved


def space_around(submaps: Submaps, bounds: NDArray[np.float32], reach_m: float) -> SpaceState:
    """Return a space that has everything within `reach_m` of bounds (2, 3), in the window or not."""
    if submaps.window is None:
        return submaps.space
    voxel_m = submaps.space.voxel_m
    low, high = np.floor((bounds[:, :2] + [[-reach_m], [reach_m]]) / voxel_m).astype(np.int64)
    around = Window((int(low[0]), int(low[1])), (int(high[0]) + 1, int(high[1]) + 1))
    if submaps.window.holds(around):
        return submaps.space
    # Tracks out of sight that are judged together lie together: one space serves them all.
    known = _AROUND.setdefault(submaps, {})
    for window, space in known.items():
        if window.holds(around):
            return space
    wide = around.wider(round(LEAST_BESIDE_M / voxel_m))
    known[wide] = _space_within(submaps, wide)
    return known[wide]


_AROUND: WeakKeyDictionary[Submaps, dict[Window, SpaceState]] = WeakKeyDictionary()


def false_floor(submaps: Submaps, seen_m: float | None) -> float | None:
    """Return the height of the presumed floor if a floor at `seen_m` refutes it, else None; in the window or not."""
    false_m = observed_space.false_floor(submaps.space, seen_m)
    if false_m is None or submaps.window is None:
        return false_m
    # In the window there is a table's worth of it: how much is there elsewhere?
    everywhere = observed_space.joined([state.space for state in submaps.states[submaps.first :]])
    return observed_space.false_floor(replace(everywhere, floor_z_m=submaps.space.floor_z_m), seen_m)


def with_seen(submaps: Submaps, seen: SpaceObservation, keep: Keep = in_memory) -> Submaps:
    """Return the submaps after one more keyframe; another storey opens a new one, since each has one floor."""
    false_m = false_floor(submaps, seen.floor_z_m)
    if false_m is None and is_another_storey(submaps.space, seen.floor_z_m):
        submaps = looking_at(_opened(_closed(submaps)), seen, keep)
    last = submaps.states[-1]
    if submaps.first == submaps.open_id:
        space = added(submaps.space, seen, false_m)
        own = space if last.space is last.seen else added(last.space, seen, false_m)
        return _alone(submaps, space, own)
    if false_m is not None:
        # What was concluded from the false floor is withdrawn in all submaps that are judged together.
        states = list(submaps.states)
        for state in states[submaps.first :]:
            own, all_seen = (without_floor(space, false_m, seen.floor_z_m) for space in (state.space, state.seen))
            states[state.id] = replace(state, space=own, seen=all_seen)
        submaps = replace(submaps, states=tuple(states))
    space = added(submaps.space, seen, false_m)
    names = ("free_keys", "structure_keys", "surface_keys")
    parts = {name: _by_owner(submaps, getattr(seen, name)) for name in names}
    changed = {}
    for i in sorted({owner for part in parts.values() for owner in part}):
        own_seen = {name: part.get(i, _NO_KEYS) for name, part in parts.items()}
        changed[i] = added(submaps.states[i].space, SpaceObservation(**own_seen, floor_z_m=None), None)
    submaps = _with_spaces(submaps, space, changed)
    own = added(submaps.states[-1].seen, replace(seen, floor_z_m=None), None)
    return _with_open(submaps, seen=replace(own, floor_z_m=space.floor_z_m))


def placed_at(submaps: Submaps, world_from_submap: Mapping[int, NDArray[np.float64]]) -> Submaps:
    """Return the submaps at corrected poses; raises `ValueError` for an unknown id."""
    # The submaps that are rigid with the open one now make up the judged space.
    unknown = sorted(world_from_submap.keys() - {state.id for state in submaps.states})
    if unknown:
        raise ValueError(f"there is no submap {unknown[0]}; the map has 0 to {submaps.open_id}")
    states = [
        replace(state, world_from_submap=world_from_submap.get(state.id, state.world_from_submap))
        for state in submaps.states
    ]
    is_corrected = any(not _is_same_place(state, states[-1]) for state in states)
    outdated = np.empty(0, np.int64) if is_corrected else None
    submaps = replace(submaps, states=tuple(replace(state, outdated=outdated) for state in states))
    first = submaps.open_id
    while first > submaps.since_jump and submaps.is_rigid_with_open(first - 1):
        first -= 1
    return submaps if first == submaps.first else _within(replace(submaps, first=first), submaps.window)


def surveyed(state: SubmapState) -> SurveyedSubmap:
    """Return a submap for the search of loops: surface that was seen twice, with a certain normal.

    Equal submaps give the same record; its arrays are made when they are read, since few are candidates.
    """
    if state not in _SURVEYED:
        assert state.anchor is not None
        _SURVEYED[state] = SurveyedSubmap(
            id=state.id,
            world_from_submap=state.world_from_submap,
            anchor=state.anchor,
            way_m=state.way_m,
            turn_rad=state.turn_rad,
            after_jump=state.after_jump,
            jump_m=state.jump_m,
            jump_rad=state.jump_rad,
            registered=state.registered,
            blind=state.blind,
            unfixed=state.unfixed,
            keypoints=state.keypoints,
            points=_NO_POINTS,
            normals=_NO_POINTS,
            free=_NO_KEYS,
            voxel_m=state.space.voxel_m,
        )
        surface, space = state.surface, state.space
        give_up(_SURVEYED[state], lambda name: _survey(surface, space, name), "points", "normals", "free")
    return _SURVEYED[state]


_SURVEYED: WeakKeyDictionary[SubmapState, SurveyedSubmap] = WeakKeyDictionary()


def _survey(surface: SubmapSurface, space: SpaceState, name: str) -> NDArray[Any]:
    if name == "free":
        return space.free.view()
    normals = surface.normals
    length = np.sqrt((normals * normals).sum(axis=1))
    is_sure = (surface.hits >= SURE_HITS) & (length > _SURE_NORMAL)
    return surface.points[is_sure] if name == "points" else normals[is_sure] / length[is_sure][:, None]


def compress_unused(submaps: Submaps, keep: Keep) -> None:
    """Compress the submaps that are not judged, or outside the window."""
    window = submaps.window
    for state in submaps.states[:-1]:
        reach = extent(state.space)
        if state.id < submaps.first or (window is not None and reach is not None and not window.meets(reach)):
            for space in (state.space, state.seen):
                compress(space, "free", "hidden_free", "surface", "hits", "misses", keep=keep)
            compress(state.surface, "keys", "points", "normals", "hits", keep=keep)
            for view in state.keypoints:
                compress(view, "descriptors", "points", keep=keep)


def shown_space(state: SubmapState) -> SpaceState:
    """Return the space of a submap that the map shows, but for outdated voxels."""
    return state.space if state.outdated is None else state.seen


def record_of_space(shown: SpaceState, outdated: NDArray[np.int64] | None) -> ObservedSpace:
    """Return the public record of a space without outdated voxels."""
    space = as_record(shown)
    if outdated is None:
        return space
    return replace(space, free=difference(space.free, outdated), structure=difference(space.structure, outdated))


def _is_same_place(a: SubmapState, b: SubmapState) -> bool:
    place = a.world_from_submap
    return place is b.world_from_submap or np.array_equal(place, b.world_from_submap)


def _within(submaps: Submaps, window: Window | None) -> Submaps:
    keys, ids = [_NO_KEYS], [np.empty(0, np.int32)]
    for state in _reaching(submaps, window):
        if state.id != submaps.open_id:
            with read_briefly(state.space):
                keys.append(_voxels(state.space if window is None else cut(state.space, window)))
            ids.append(np.full(len(keys[-1]), state.id, np.int32))
    owned, owners = np.concatenate(keys), np.concatenate(ids)
    # Of submaps that were moved apart for a while both may have a voxel: it is the earlier one's again.
    owned, at = np.unique(owned, return_index=True)
    space = _space_within(submaps, window)
    return replace(submaps, space=space, owned=owned, owners=owners[at], window=window)


def _space_within(submaps: Submaps, window: Window | None) -> SpaceState:
    last = submaps.states[-1].space
    some = []
    for state in _reaching(submaps, window):
        with read_briefly(state.space, state.seen):
            some.append(shown_space(state) if window is None else cut(shown_space(state), window))
    space = observed_space.joined(some or [empty_space(last.voxel_m)])
    return replace(space, floor_z_m=last.floor_z_m if window is None else submaps.space.floor_z_m)


def _reaching(submaps: Submaps, window: Window | None) -> Iterator[SubmapState]:
    # The judged submaps that reach into a window.
    for state in submaps.states[submaps.first :]:
        # Extents are cached by space; the shown space lies within these.
        spaces = [state.space] if state.outdated is None else [state.space, state.seen]
        reaches = [extent(space) for space in spaces]
        if any(reach is not None and (window is None or window.meets(reach)) for reach in reaches):
            yield state


def _closed(submaps: Submaps) -> Submaps:
    own = submaps.states[-1].space
    # While it was moved apart it may have taken a voxel of an earlier one, which keeps it.
    keys = difference(_voxels(own if submaps.window is None else cut(own, submaps.window)), submaps.owned)
    owned = np.concatenate([submaps.owned, keys])
    owners = np.concatenate([submaps.owners, np.full(len(keys), submaps.open_id, dtype=np.int32)])
    order = np.argsort(owned, kind="stable")
    return replace(submaps, owned=owned[order], owners=owners[order])


def _opened(submaps: Submaps) -> Submaps:
    last, outdated = submaps.states[-1], None if submaps.states[-1].outdated is None else _NO_KEYS
    space = replace(empty_space(submaps.space.voxel_m), floor_z_m=submaps.space.floor_z_m)
    place = last.world_from_submap
    state = SubmapState(id=last.id + 1, world_from_submap=place, space=space, seen=space, outdated=outdated)
    return replace(submaps, states=(*submaps.states, state))


def _with_open(submaps: Submaps, **changes: Any) -> Submaps:
    return replace(submaps, states=(*submaps.states[:-1], replace(submaps.states[-1], **changes)))


def _alone(submaps: Submaps, space: SpaceState, owned: SpaceState) -> Submaps:
    # Only the open submap is judged: it saw the whole space, and owns the part `owned`.
    return replace(_with_open(submaps, space=owned, seen=space), space=space)


def _with_spaces(submaps: Submaps, space: SpaceState, changed: Mapping[int, SpaceState]) -> Submaps:
    states = list(submaps.states)
    for i, own in changed.items():
        states[i] = replace(states[i], space=own)
    # Only the open submap follows the current floor: closed ones keep the floor that was seen in them, if any was.
    for i in range(submaps.first, submaps.open_id):
        if states[i].space.floor_z_m is None and space.floor_z_m is not None:
            states[i] = replace(states[i], space=replace(states[i].space, floor_z_m=space.floor_z_m))
    last = states[-1]
    states[-1] = replace(last, space=replace(last.space, floor_z_m=space.floor_z_m))
    return replace(submaps, space=space, states=tuple(states))


def _voxels(space: SpaceState) -> NDArray[np.int64]:
    return union(space.free, space.surface)


def _owners(submaps: Submaps, keys: NDArray[np.int64]) -> NDArray[np.int32]:
    # (N,) the id of the submap that owns each voxel; new voxels belong to the open one.
    owners = np.full(len(keys), submaps.open_id, dtype=np.int32)
    sight = window_of(keys)
    if submaps.window is not None and sight is not None and not submaps.window.holds(sight):
        submaps = _within(submaps, sight)
    at = places(submaps.owned, keys)
    at[at == len(submaps.owned)] = -1
    return owners if len(submaps.owned) == 0 else np.where(submaps.owned[at] == keys, submaps.owners[at], owners)


def _by_owner(submaps: Submaps, keys: NDArray[np.int64]) -> dict[int, NDArray[np.int64]]:
    owners = _owners(submaps, keys)
    return {i: keys[owners == i] for i in np.flatnonzero(np.bincount(owners)).tolist()}
