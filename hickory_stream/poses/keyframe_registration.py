"""Keyframes that fit the map: each is registered to the surface of those before, within what odometry leaves open.

The pose of a keyframe is expected where the odometry has it, with a covariance that grows with the way and the turning
since the last one that was registered. Its depth is aligned with patches of surface of earlier keyframes
(`surface_alignment`): the last ones, and those that saw most of the same. From the result follows `map_from_odometry`,
which is the identity as long as the surface agrees with the odometry: exact poses stay exact to the last bit. Once it
was contradicted, every keyframe is registered.

A keyframe of which too much is seen through the surface, or that would have to be moved farther than odometry errs,
does not fit, and is kept out. After many of these in a row the robot is somewhere else, and the surface begins anew.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

import numpy as np

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

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from hickory_stream.poses.registration_config import RegistrationConfig
    from hickory_stream.poses.surface_image import SurfaceImage

_SURE = 1e-4
"""The first keyframe lies where it lies, in m and rad."""
_NOTHING = 1e-3
"""An information that is as good as none: of 30 m, or of half a turn."""
_LEAST_SEEN = 0.3
_SHARE_STEPS = 8
_MOST_WIDENED = 8.0
_TESTED_EVERY = 4
_STRONG_COSINE, _LEAST_STRONG = 0.6, 30.0
"""Of every sixteenth cell, at least so many must face a direction: a hundredth of a wall that fills the image."""
_EVERY_DIRECTION, _NO_DIRECTION = np.eye(6), no_directions()

KeyframeRegistrar = Literal["first", "fits", "new ground", "begun anew"]
"""How the pose of a keyframe was found: it fits the surface; or there is none to compare it with."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Belief:
    """What is known of the odometry after a keyframe.

    `map_from_odometry` (4, 4); `covariance` (6, 6) of the camera's pose against the surface: rotation vector, then
    translation, along the map's axes. `corrects`: the odometry was contradicted before. `num_against`: the keyframes in
    a row that contradict it. `odometry_from_camera` (4, 4) is that of the keyframe.
    """

    map_from_odometry: NDArray[np.float64]
    covariance: NDArray[np.float64]
    corrects: bool
    num_against: int
    odometry_from_camera: NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Placed:
    """Where a keyframe is mapped: `map_from_camera` (4, 4), and what is believed from then on.

    `fit` is the share of the points to compare that lie on the surface, None where there are too few. Later keyframes
    may be registered to an anchor. Along the unit directions `degenerate` (K, 6), of the map's axes, rotation first,
    the surface said nothing.
    """

    how: KeyframeRegistrar
    map_from_camera: NDArray[np.float64]
    belief: Belief
    fit: float | None
    is_anchor: bool
    degenerate: NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Remembered:
    """A keyframe to which later ones are registered; `number` counts those that were placed, from 0."""

    image: SurfaceImage
    map_from_camera: NDArray[np.float64]
    number: int
    is_anchor: bool


@dataclass(frozen=True, kw_only=True, slots=True)
class KeptOut:
    """A keyframe does not fit the map: an expected outcome."""

    reason: str


class KeyframeRegistration:
    """The surface of the keyframes so far, and where the odometry's world lies in the map's."""

    def __init__(self, config: RegistrationConfig) -> None:
        self._config = config
        self._anchors: list[Patch] = []
        self._recent: list[Patch] = []
        self._belief: Belief | None = None
        self._widened = 1.0
        self._has_jumped = False
        self._num_kept_out = 0
        self._num_placed = 0

    @property
    def map_from_odometry(self) -> NDArray[np.float64]:
        """Where the odometry's world lies in the map's, (4, 4)."""
        return np.eye(4) if self._belief is None else self._belief.map_from_odometry

    def jumped(self) -> None:
        """Take note that the odometry or the stamps jumped: the next keyframe may be off, or be elsewhere."""
        self._has_jumped = self._belief is not None

    def began_again(self) -> None:
        """Take note that the odometry is in its first world again: a log is played once more."""
        if self._belief is not None:
            self._belief = _fresh(self._belief.odometry_from_camera)
            self._has_jumped = True

    def place(
        self,
        image: SurfaceImage,
        odometry_from_camera: NDArray[np.float64],
        unseen: NDArray[np.float64] = _NO_DIRECTION,
    ) -> Placed | KeptOut:
        """Return where a keyframe belongs that the odometry has at `odometry_from_camera` (4, 4), or why nowhere.

        The odometry's own scans said nothing along the directions `unseen` (K, 6) of the camera (`Frame.degenerate`).
        """
        if self._belief is None:
            return self._accepted("first", image, _fresh(odometry_from_camera), None)
        prior = self._prior(odometry_from_camera, unseen)
        found = align(image, self._patches(image, prior.map_from_camera), prior, self._config)
        expected = self._expected(prior, odometry_from_camera)
        fit = found.fit(self._config.least_points)
        reason = self._why_not(found, fit, prior)
        if reason is None and fit is None:
            return self._accepted("new ground", image, expected, None)
        if reason is None:
            unknown = _degenerate_in_map(image, prior.map_from_camera)
            registered = self._registered(found, prior, expected, unknown, is_guess=len(unseen) > 0)
            return self._accepted("fits", image, registered, fit, unknown)
        self._num_kept_out += 1
        if not self._has_jumped and self._num_kept_out < self._config.lost_keyframes:
            self._widened = min(2.0 * self._widened, _MOST_WIDENED)
            return KeptOut(reason=reason)
        self._anchors, self._recent = [], []
        return self._accepted("begun anew", image, expected, fit)

    def restore(self, belief: Belief, remembered: Sequence[Remembered], num_placed: int) -> None:
        """Go on as after a keyframe: its belief, the keyframes that are remembered in their order, and how many came.

        Those are the anchors since the surface began, and the last ones.
        """
        self._belief, self._num_placed = belief, num_placed
        self._widened, self._has_jumped, self._num_kept_out = 1.0, False, 0
        patches = [patch_of(each.image, each.map_from_camera, odd=each.number % 2 == 1) for each in remembered]
        anchors = [patch for patch, each in zip(patches, remembered, strict=True) if each.is_anchor]
        self._anchors = anchors[-self._config.max_anchors :]
        self._recent = patches[-self._config.num_recent :] if self._config.num_recent else []

    # ---- what is expected --------------------------------------------------------------------------------------------

    def _prior(self, odometry_from_camera: NDArray[np.float64], unseen: NDArray[np.float64]) -> PosePrior:
        """Return the pose that the odometry has, with its covariance since the last keyframe that was mapped.

        Along what its scans did not see it is a guess, and errs by a share of all of the way.
        """
        config, belief = self._config, self._belief
        assert belief is not None
        before, now = belief.odometry_from_camera, odometry_from_camera
        way_m = portable.norm(now[:3, 3] - before[:3, 3])
        turned = rotation_angle_rad(portable.matmul(before[:3, :3].T, now[:3, :3]))
        turn_deg = config.turn_deg + config.turn_of_metre_deg * way_m + config.turn_share * np.degrees(turned)
        moved_m = config.step_m + config.way_share * way_m
        if self._has_jumped:
            turn_deg, moved_m = turn_deg + config.jump_deg, moved_m + config.jump_m
        spread = self._widened * np.array([*3 * [np.radians(turn_deg)], *3 * [moved_m]])
        map_from_camera = compose(belief.map_from_odometry, now)
        lever = portable.matmul(belief.map_from_odometry[:3, :3], now[:3, 3] - before[:3, 3])
        covariance = _carried(belief.covariance, lever) + np.diag(spread * spread)
        if len(unseen):
            guessed = config.unseen_share * np.array([turned, turned, turned, way_m, way_m, way_m])
            guesses = turned_directions(map_from_camera, unseen) * guessed
            covariance = covariance + portable.matmul(guesses.T, guesses)
        tilt_rad = np.radians(config.tilt_deg)
        return PosePrior(
            map_from_camera=map_from_camera,
            information=inverse(covariance),
            tilt=rotation_vector(belief.map_from_odometry[:3, :3])[:2],
            tilt_information=float(1.0 / (tilt_rad * tilt_rad)),
        )

    def _expected(self, prior: PosePrior, odometry_from_camera: NDArray[np.float64]) -> Belief:
        """Return what is believed if the odometry is taken as it is."""
        assert self._belief is not None
        return Belief(
            map_from_odometry=self._belief.map_from_odometry,
            covariance=inverse(prior.information),
            corrects=self._belief.corrects,
            num_against=0,
            odometry_from_camera=odometry_from_camera,
        )

    def _patches(self, image: SurfaceImage, map_from_camera: NDArray[np.float64]) -> list[Patch]:
        """Return the last keyframes, and of those before the ones that saw most of the same, the oldest first."""
        config = self._config
        camera_from_map = invert(map_from_camera)
        recent = {id(patch) for patch in self._recent}
        others = [patch for patch in self._anchors if id(patch) not in recent]
        shares = [share_seen(patch, camera_from_map, image.camera) for patch in others]
        order = sorted(range(len(others)), key=lambda i: (-round(_SHARE_STEPS * shares[i]), i))
        wanted = max(config.num_patches - len(self._recent), 0)
        chosen = [others[i] for i in order[:wanted] if shares[i] >= _LEAST_SEEN]
        return [*chosen, *self._recent]

    # ---- what is made of it ------------------------------------------------------------------------------------------

    def _why_not(self, found: Aligned, fit: float | None, prior: PosePrior) -> str | None:
        """Return why a keyframe does not fit, None where it does, or where nothing speaks against it."""
        config = self._config
        if fit is not None and not fit >= config.least_fit:
            return f"{fit:.0%} of what it should show of the map is there; expected {config.least_fit:.0%} and more"
        sigmas = _sigmas(found.off, prior.information)
        if fit is not None and not sigmas <= config.bound_sigmas:
            moved_m, turned_deg = portable.norm(found.off[3:]), float(np.degrees(portable.norm(found.off[:3])))
            return (
                f"it fits {moved_m:.2f} m and {turned_deg:.1f} degrees from where the odometry has it, {sigmas:.0f} "
                f"sigma of its drift; expected {config.bound_sigmas:g} and less"
            )
        # Who does not know where he is does not learn it from new ground, nor from a floor.
        is_lost = self._num_kept_out > 0 or self._has_jumped
        if is_lost and (fit is None or not self._tells_where(found)):
            return "too little of the map is in sight to say where it is after what did not fit"
        return None

    def _tells_where(self, found: Aligned) -> bool:
        """Return whether the surface alone says where a keyframe is, in every direction."""
        variances = np.diag(inverse(found.information + _NOTHING * np.eye(6)))
        limits = np.array([*3 * [np.radians(self._config.found_deg)], *3 * [self._config.found_m]])
        return bool((variances <= limits * limits).all())

    def _registered(
        self, found: Aligned, prior: PosePrior, expected: Belief, unknown: NDArray[np.float64], *, is_guess: bool
    ) -> Belief:
        """Return what is believed after a keyframe that fits; its surface says nothing along `unknown` (K, 6)."""
        config, belief = self._config, self._belief
        assert belief is not None
        off, information = _without(unknown, found.off), _information_without(unknown, found.information)
        covariance = inverse(prior.information + information)
        num_against = 0
        if not belief.corrects and _sigmas(off, information) > config.contradiction_sigmas:
            num_against = belief.num_against + 1
        # After a jump, or what did not fit, or against a guess, one word of the surface is enough.
        is_enough = num_against >= config.contradictions or self._has_jumped or self._num_kept_out > 0 or is_guess
        corrects = belief.corrects or (num_against > 0 and is_enough)
        if not corrects:
            return replace(expected, covariance=covariance, num_against=num_against)
        map_from_camera = moved_by(prior.map_from_camera, off)
        return Belief(
            map_from_odometry=compose(map_from_camera, invert(expected.odometry_from_camera)),
            covariance=covariance,
            corrects=True,
            num_against=0,
            odometry_from_camera=expected.odometry_from_camera,
        )

    def _accepted(
        self,
        how: KeyframeRegistrar,
        image: SurfaceImage,
        belief: Belief,
        fit: float | None,
        degenerate: NDArray[np.float64] = _EVERY_DIRECTION,
    ) -> Placed:
        """Return a keyframe's place, and remember its surface; nothing to compare it with says nothing at all."""
        config = self._config
        # Without a correction the pose is the odometry's to the last bit.
        is_identity = np.array_equal(belief.map_from_odometry, np.eye(4))
        odometry = belief.odometry_from_camera
        map_from_camera = odometry if is_identity else compose(belief.map_from_odometry, odometry)
        patch = patch_of(image, map_from_camera, odd=self._num_placed % 2 == 1)
        covering = sum(
            share_seen(patch, invert(anchor.map_from_camera), image.camera) > config.anchor_overlap
            for anchor in self._anchors
        )
        is_anchor = covering < config.num_covering
        if is_anchor:
            self._anchors = [*self._anchors, patch][-config.max_anchors :]
        self._recent = [*self._recent, patch][-config.num_recent :] if config.num_recent else []
        self._num_placed += 1
        self._belief = belief
        self._widened, self._has_jumped, self._num_kept_out = 1.0, False, 0
        return Placed(
            how=how,
            map_from_camera=map_from_camera,
            belief=belief,
            fit=fit,
            is_anchor=is_anchor,
            degenerate=degenerate,
        )


def _fresh(odometry_from_camera: NDArray[np.float64]) -> Belief:
    """Return what is believed at the start: the map's world is the odometry's."""
    return Belief(
        map_from_odometry=np.eye(4),
        covariance=np.diag(np.full(6, _SURE * _SURE)),
        corrects=False,
        num_against=0,
        odometry_from_camera=odometry_from_camera,
    )


def _carried(covariance: NDArray[np.float64], lever: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a covariance (6, 6) about another point, `lever` (3,) away: what turns about the one moves the other."""
    x, y, z = lever
    carry = np.eye(6)
    carry[3:, :3] = np.array([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]])
    return portable.matmul(portable.matmul(carry, covariance), carry.T)


def _sigmas(off: NDArray[np.float64], information: NDArray[np.float64]) -> float:
    """Return how many standard deviations something is off."""
    return float(np.sqrt(max(portable.dot(off, portable.matmul(information, off)), 0.0)))


def _degenerate_in_map(image: SurfaceImage, map_from_camera: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (K, 6) the directions that a keyframe's surface leaves open, rotation first, along the map's axes."""
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
