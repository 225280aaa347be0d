"""Registration of keyframes to the surface of earlier ones, within the uncertainty of odometry.

The odometry gives the expected pose; its covariance grows with the path since the last registered keyframe. The depth
is aligned with patches of the last keyframes and of those with the most common surface (`surface_alignment`).
`map_from_odometry` stays the identity, to the last bit, until the surface contradicts the odometry. A keyframe that
sees through the surface, or fits too far away, is kept out; after many in a row the surface starts again.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry import portable
from hickory_stream.geometry.rigid import (
    compose,
    invert,
    no_directions,
    rotation_angle_rad,
    rotation_vector,
    turned_directions,
)
from hickory_stream.poses.degeneracy import Surfels, degenerate_directions
from hickory_stream.poses.registration_config import RegistrationConfig
from hickory_stream.poses.surface_alignment import (
    Aligned,
    Patch,
    PosePrior,
    align,
    inverse,
    moved_by,
    patch_of,
    share_seen,
)
from hickory_stream.poses.surface_image import SurfaceImage

# The sigma of the first keyframe's pose, in m and rad.
_SURE = 1e-4
# An information that is as good as none: of 30 m, or of half a turn.
_NOTHING = 1e-3
_LEAST_SEEN = 0.3
_SHARE_STEPS = 8
_MOST_WIDENED = 8.0
_TESTED_EVERY = 4
# Of every sixteenth cell, at least so many must face a direction: a hundredth of a wall that fills the image.
_STRONG_COSINE, _LEAST_STRONG = 0.6, 30.0
_EVERY_DIRECTION, _NO_DIRECTION = np.eye(6), no_directions()

# How the pose of a keyframe was found: it fits the surface, or there is none to compare it with.
RegistrationKind = Literal["first", "fits", "new ground", "begun anew"]

# The odometry's error that each keyframe adds, beside `drift_share` and `turn_share`.
_STEP_M = 0.001
_TURN_DEG = 0.05
# The odometry's error in rotation, for every metre of the path.
_TURN_OF_METRE_DEG = 0.05
# The odometry's error along a motion that its own scans did not constrain, as a share of that motion.
_UNSEEN_SHARE = 0.3
# The greatest error of the odometry's vertical, at any time.
_TILT_DEG = 0.5
# The odometry's error after it, or the stamps, jumped.
_JUMP_M = 0.05
_JUMP_DEG = 2.0
# From this many keyframes in a row that contradict the odometry by this much on, every keyframe is registered.
_CONTRADICTION_SIGMAS = 2.5
_CONTRADICTIONS = 4
# A result farther from the odometry than this is rejected.
_BOUND_SIGMAS = 6.0
# A keyframe is registered to at most this many earlier ones, of which so many are the last ones.
_NUM_PATCHES = 12
NUM_RECENT = 3
# A keyframe that shares more than this with so many remembered ones need not be remembered.
_ANCHOR_OVERLAP = 0.7
_NUM_COVERING = 3
# With fewer points to compare the ground is new, and the pose is the odometry's.
_MIN_POINTS = 300
# A keyframe with a smaller share of its compared points on the surface is kept out of the map.
_MIN_FIT = 0.35
# After a keyframe that was kept out, or a jump, the surface alone must be as sure as this of the pose.
_FOUND_M = 0.02
_FOUND_DEG = 1.0
# After this many in a row that were kept out the robot is elsewhere: the surface starts again.
LOST_KEYFRAMES = 8


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Belief:
    """The state of the odometry after a keyframe."""

    map_from_odometry: NDArray[np.float64]
    #: (6, 6) of the camera's pose: rotation vector, then translation, along the map's axes
    covariance: NDArray[np.float64]
    #: the odometry was contradicted before
    corrects: bool
    #: keyframes in a row that contradict the odometry
    num_against: int
    odometry_from_camera: NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Placed:
    """The place of a keyframe in the map, and the belief from then on."""

    how: RegistrationKind
    map_from_camera: NDArray[np.float64]
    belief: Belief
    #: share of the compared points that lie on the surface, None if there are too few
    fit: float | None
    #: later keyframes may be registered to it
    is_anchor: bool
    #: (K, 6) unit directions, of the map's axes, rotation first, that the surface left open
    degenerate: NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Remembered:
    """A keyframe to which later ones are registered; `number` counts the placed ones from 0."""

    image: SurfaceImage
    map_from_camera: NDArray[np.float64]
    number: int
    is_anchor: bool


@dataclass(frozen=True, kw_only=True, slots=True)
class KeptOut:
    """A keyframe does not fit the map: an expected outcome."""

    reason: str


class KeyframeRegistration:
    """The surface of the keyframes so far, and the place of the odometry's world in the map's."""

    def __init__(self, config: RegistrationConfig) -> None:
        self._config = config
        self._anchors, self._recent = list[Patch](), list[Patch]()
        self._belief: Belief | None = None
        self._widened, self._has_jumped = 1.0, False
        self._num_kept_out = self._num_placed = 0

    @property
    def map_from_odometry(self) -> NDArray[np.float64]:
        """The pose of the odometry's world in the map's, (4, 4)."""
        return np.eye(4) if self._belief is None else self._belief.map_from_odometry

    def jumped(self) -> None:
        """Expect the next keyframe to be off or elsewhere: the odometry or the stamps jumped."""
        self._has_jumped = self._belief is not None

    def began_again(self) -> None:
        """Return to the odometry's first world: a log is played once more."""
        if self._belief is not None:
            self._belief = _fresh(self._belief.odometry_from_camera)
            self._has_jumped = True

    def place(
        self,
        image: SurfaceImage,
        odometry_from_camera: NDArray[np.float64],
        unseen: NDArray[np.float64] = _NO_DIRECTION,
    ) -> Placed | KeptOut:
        """Return the place of a keyframe that the odometry has at `odometry_from_camera` (4, 4), or why it has none.

        The odometry's scans did not constrain the directions `unseen` (K, 6) of the camera (`Frame.degenerate`).
        """
        if self._belief is None:
            return self._accepted("first", image, _fresh(odometry_from_camera), None)
        prior = self._prior(odometry_from_camera, unseen)
        found = align(image, self._patches(image, prior.map_from_camera), prior)
        expected = self._expected(prior, odometry_from_camera)
        fit = found.fit(_MIN_POINTS)
        reason = self._why_not(found, fit, prior)
        if reason is None and fit is None:
            return self._accepted("new ground", image, expected, None)
        if reason is None:
            unknown = _degenerate_in_map(image, prior.map_from_camera)
            registered = self._registered(found, prior, expected, unknown, is_guess=len(unseen) > 0)
            return self._accepted("fits", image, registered, fit, unknown)
        self._num_kept_out += 1
        if not self._has_jumped and self._num_kept_out < LOST_KEYFRAMES:
            self._widened = min(2.0 * self._widened, _MOST_WIDENED)
            return KeptOut(reason=reason)
        self._anchors, self._recent = [], []
        return self._accepted("begun anew", image, expected, fit)

    def restore(self, belief: Belief, remembered: Sequence[Remembered], num_placed: int) -> None:
        """Continue as after a keyframe, from its belief, the remembered keyframes, and the number of placed ones.

        The remembered keyframes, in order, are the anchors since the surface began and the last keyframes.
        """
        self._belief, self._num_placed = belief, num_placed
        self._widened, self._has_jumped, self._num_kept_out = 1.0, False, 0
        patches = [patch_of(each.image, each.map_from_camera, odd=each.number % 2 == 1) for each in remembered]
        anchors = [patch for patch, each in zip(patches, remembered, strict=True) if each.is_anchor]
        self._anchors = anchors[-self._config.max_anchors :]
        self._recent = patches[-NUM_RECENT:]

    def _prior(self, odometry_from_camera: NDArray[np.float64], unseen: NDArray[np.float64]) -> PosePrior:
        # The covariance grows since the last mapped keyframe; along `unseen` by a share of the whole motion.
        config, belief = self._config, self._belief
        assert belief is not None
        before, now = belief.odometry_from_camera, odometry_from_camera
        way_m = portable.norm(now[:3, 3] - before[:3, 3])
        turned = rotation_angle_rad(portable.matmul(before[:3, :3].T, now[:3, :3]))
        turn_deg = _TURN_DEG + _TURN_OF_METRE_DEG * way_m + config.turn_share * np.degrees(turned)
        moved_m = _STEP_M + config.drift_share * way_m
        if self._has_jumped:
            turn_deg, moved_m = turn_deg + _JUMP_DEG, moved_m + _JUMP_M
        spread = self._widened * np.array([*3 * [np.radians(turn_deg)], *3 * [moved_m]])
        map_from_camera = compose(belief.map_from_odometry, now)
        lever = portable.matmul(belief.map_from_odometry[:3, :3], now[:3, 3] - before[:3, 3])
        covariance = _carried(belief.covariance, lever) + np.diag(spread * spread)
        if len(unseen):
            guessed = _UNSEEN_SHARE * np.array([turned, turned, turned, way_m, way_m, way_m])
            guesses = turned_directions(map_from_camera, unseen) * guessed
            covariance = covariance + portable.matmul(guesses.T, guesses)
        tilt_rad = np.radians(_TILT_DEG)
        return PosePrior(
            map_from_camera=map_from_camera,
            information=inverse(covariance),
            tilt=rotation_vector(belief.map_from_odometry[:3, :3])[:2],
            tilt_information=float(1.0 / (tilt_rad * tilt_rad)),
        )

    def _expected(self, prior: PosePrior, odometry_from_camera: NDArray[np.float64]) -> Belief:
        assert self._belief is not None
        expected = replace(self._belief, covariance=inverse(prior.information), num_against=0)
        return replace(expected, odometry_from_camera=odometry_from_camera)

    def _patches(self, image: SurfaceImage, map_from_camera: NDArray[np.float64]) -> list[Patch]:
        # The last keyframes, and of those before the ones with most of the same surface, the oldest first.
        camera_from_map = invert(map_from_camera)
        recent = {id(patch) for patch in self._recent}
        others = [patch for patch in self._anchors if id(patch) not in recent]
        shares = [share_seen(patch, camera_from_map, image.camera) for patch in others]
        order = sorted(range(len(others)), key=lambda i: (-round(_SHARE_STEPS * shares[i]), i))
        wanted = max(_NUM_PATCHES - len(self._recent), 0)
        chosen = [others[i] for i in order[:wanted] if shares[i] >= _LEAST_SEEN]
        return [*chosen, *self._recent]

    def _why_not(self, found: Aligned, fit: float | None, prior: PosePrior) -> str | None:
        # Why a keyframe does not fit, None where it does, or where nothing speaks against it.
        if fit is not None and not fit >= _MIN_FIT:
            return f"{fit:.0%} of what it should show of the map is there; expected {_MIN_FIT:.0%} and more"
        sigmas = _sigmas(found.off, prior.information)
        if fit is not None and not sigmas <= _BOUND_SIGMAS:
            moved_m, turned_deg = portable.norm(found.off[3:]), float(np.degrees(portable.norm(found.off[:3])))
            # Rounded up, so that what is too much also reads so.
            times = float(np.ceil(10 * sigmas) / 10)
            return (
                f"its surface fits the map {moved_m:.2f} m and {turned_deg:.1f} degrees from the odometry's pose, "
                f"{times:.1f} times the odometry's expected drift; at most {_BOUND_SIGMAS:g} times is accepted"
            )
        # Neither new ground nor a floor locates a lost robot.
        is_lost = self._num_kept_out > 0 or self._has_jumped
        if is_lost and (fit is None or not self._tells_where(found)):
            return "too little of the map is in sight to locate it after keyframes that did not fit"
        return None

    def _tells_where(self, found: Aligned) -> bool:
        variances = np.diag(inverse(found.information + _NOTHING * np.eye(6)))
        limits = np.array([*3 * [np.radians(_FOUND_DEG)], *3 * [_FOUND_M]])
        return bool((variances <= limits * limits).all())

    def _registered(
        self, found: Aligned, prior: PosePrior, expected: Belief, unknown: NDArray[np.float64], *, is_guess: bool
    ) -> Belief:
        # The surface says nothing along `unknown` (K, 6).
        belief = self._belief
        assert belief is not None
        off, information = _without(unknown, found.off), _information_without(unknown, found.information)
        covariance = inverse(prior.information + information)
        num_against = 0
        if not belief.corrects and _sigmas(off, information) > _CONTRADICTION_SIGMAS:
            num_against = belief.num_against + 1
        # After a jump, or what did not fit, or against a guess, one word of the surface is enough.
        is_enough = num_against >= _CONTRADICTIONS or self._has_jumped or self._num_kept_out > 0 or is_guess
        corrects = belief.corrects or (num_against > 0 and is_enough)
        if not corrects:
            return replace(expected, covariance=covariance, num_against=num_against)
        map_from_odometry = compose(moved_by(prior.map_from_camera, off), invert(expected.odometry_from_camera))
        return replace(expected, map_from_odometry=map_from_odometry, covariance=covariance, corrects=True)

    def _accepted(
        self,
        how: RegistrationKind,
        image: SurfaceImage,
        belief: Belief,
        fit: float | None,
        degenerate: NDArray[np.float64] = _EVERY_DIRECTION,
    ) -> Placed:
        config = self._config
        # Without a correction the pose is the odometry's to the last bit.
        is_identity = np.array_equal(belief.map_from_odometry, np.eye(4))
        odometry = belief.odometry_from_camera
        map_from_camera = odometry if is_identity else compose(belief.map_from_odometry, odometry)
        patch = patch_of(image, map_from_camera, odd=self._num_placed % 2 == 1)
        shares = (share_seen(patch, invert(anchor.map_from_camera), image.camera) for anchor in self._anchors)
        is_anchor = sum(share > _ANCHOR_OVERLAP for share in shares) < _NUM_COVERING
        if is_anchor:
            self._anchors = [*self._anchors, patch][-config.max_anchors :]
        self._recent = [*self._recent, patch][-NUM_RECENT:]
        self._num_placed += 1
        self._belief = belief
        self._widened, self._has_jumped, self._num_kept_out = 1.0, False, 0
        poses = {"map_from_camera": map_from_camera, "degenerate": degenerate}
        return Placed(how=how, belief=belief, fit=fit, is_anchor=is_anchor, **poses)


def _fresh(odometry_from_camera: NDArray[np.float64]) -> Belief:
    return Belief(
        map_from_odometry=np.eye(4),
        covariance=np.diag(np.full(6, _SURE * _SURE)),
        corrects=False,
        num_against=0,
        odometry_from_camera=odometry_from_camera,
    )


def _carried(covariance: NDArray[np.float64], lever: NDArray[np.float64]) -> NDArray[np.float64]:
    # A covariance (6, 6) about another point, `lever` (3,) away: a turn about the one moves the other.
    x, y, z = lever
    carry = np.eye(6)
    carry[3:, :3] = np.array([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]])
    return portable.matmul(portable.matmul(carry, covariance), carry.T)


def _sigmas(off: NDArray[np.float64], information: NDArray[np.float64]) -> float:
    return float(np.sqrt(max(portable.dot(off, portable.matmul(information, off)), 0.0)))


def _degenerate_in_map(image: SurfaceImage, map_from_camera: NDArray[np.float64]) -> NDArray[np.float64]:
    # (K, 6) directions that a keyframe's surface leaves open, rotation first, along the map's axes.
    sampled = (slice(None, None, _TESTED_EVERY), slice(None, None, _TESTED_EVERY))
    has = ~np.isnan(image.sigma_m[sampled])
    surfels = Surfels(points=image.points[sampled][has], normals=image.normals[sampled][has], weight=1.0)
    open_ones = degenerate_directions(surfels, strong_cosine=_STRONG_COSINE, least_strong=_LEAST_STRONG)
    return turned_directions(map_from_camera, open_ones)


def _without(directions: NDArray[np.float64], off: NDArray[np.float64]) -> NDArray[np.float64]:
    for direction in directions:
        off = off - portable.dot(direction, off) * direction
    return off


def _information_without(directions: NDArray[np.float64], information: NDArray[np.float64]) -> NDArray[np.float64]:
    for direction in directions:
        keep = np.eye(6) - direction[:, None] * direction[None, :]
        information = portable.matmul(portable.matmul(keep, information), keep)
    return information
