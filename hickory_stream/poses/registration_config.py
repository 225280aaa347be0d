"""What the registration of keyframes is configured by: how the odometry may drift, and what fits."""

from __future__ import annotations

from dataclasses import dataclass

from hickory_stream.base.ranges import Ranged, check_order, check_ranges, number


@dataclass(frozen=True, kw_only=True, slots=True)
class RegistrationConfig(Ranged):
    """How keyframes are registered to the surface of those before, and which of them are kept out of the map.

    Attributes:
        enabled: whether keyframes are registered at all.
        way_share: one standard deviation of the odometry's error, as a share of the way ...
        step_m: ... and what is added to it for every keyframe.
        turn_share: the same of its rotation, as a share of what was turned ...
        turn_of_metre_deg: ... for every metre of the way ...
        turn_deg: ... and for every keyframe.
        unseen_share: the same of the way, and of the turn, along what the odometry's own scans did not see.
        tilt_deg: how far the odometry's vertical may be off, ever.
        jump_m, jump_deg: how far the odometry may be off after it, or the stamps, jumped.
        contradiction_sigmas: the odometry is believed as it is until the surface disagrees with it by so much ...
        contradictions: ... in so many keyframes in a row; from then on every keyframe is registered.
        bound_sigmas: a result farther from the odometry than this is none.
        max_depth_sigma_m: returns less sure than this are not used.
        surface_noise_m: surfaces are no smoother than this: what is added to the noise of a point.
        num_independent: the points of a keyframe count as no more independent measurements than this.
        first_scale_m, last_scale_m: scale of the robust kernel, in the first and in the last steps.
        num_iterations: steps of one registration.
        least_cosine: surfaces whose normals differ more than this are not the same.
        num_patches: a keyframe is registered to at most so many earlier ones ...
        num_recent: ... of which so many are the last ones.
        max_anchors: so many earlier keyframes are remembered; the oldest are forgotten first.
        anchor_overlap: a keyframe that shares more than this with `num_covering` remembered ones need not be.
        least_points: where fewer points can be compared the ground is new, and the odometry is taken as it is.
        least_fit: of points that can be compared, at least this share lies on the surface; else a keyframe is kept out.
        found_m, found_deg: after one that was kept out, or a jump, the surface alone must be as sure as this of a
            keyframe's pose.
        lost_keyframes: after so many in a row that were kept out the robot is somewhere else: the surface begins anew.
    """

    enabled: bool = True
    way_share: float = number(0.02, 0, 1, "share")
    step_m: float = number(0.001, 0.0001, 1, "m")
    turn_share: float = number(0.01, 0, 1, "share")
    turn_of_metre_deg: float = number(0.05, 0, 90, "deg")
    turn_deg: float = number(0.05, 0.001, 90, "deg")
    unseen_share: float = number(0.3, 0, 1, "share")
    tilt_deg: float = number(0.5, 0.01, 180, "deg")
    jump_m: float = number(0.05, 0, 10, "m")
    jump_deg: float = number(2.0, 0, 180, "deg")
    contradiction_sigmas: float = number(2.5, 0, 1000, "sigmas")
    contradictions: int = number(4, 1, 1000, "keyframes")
    bound_sigmas: float = number(6.0, 1, 1000, "sigmas")
    max_depth_sigma_m: float = number(0.1, 0.001, 10, "m")
    surface_noise_m: float = number(0.005, 0.0001, 1, "m")
    num_independent: float = number(200.0, 1, 1e6, "measurements")
    first_scale_m: float = number(0.06, 0.001, 10, "m")
    last_scale_m: float = number(0.015, 0.001, 10, "m")
    num_iterations: int = number(6, 1, 100, "iterations")
    least_cosine: float = number(0.85, -1, 1, "ratio")
    num_patches: int = number(12, 1, 1000, "keyframes")
    num_recent: int = number(3, 0, 1000, "keyframes")
    max_anchors: int = number(300, 1, 100_000, "keyframes")
    anchor_overlap: float = number(0.7, 0, 1, "share")
    num_covering: int = number(3, 1, 1000, "keyframes")
    least_points: int = number(300, 1, 1_000_000, "points")
    least_fit: float = number(0.35, 0, 1, "share")
    found_m: float = number(0.02, 0.0001, 10, "m")
    found_deg: float = number(1.0, 0.001, 180, "deg")
    lost_keyframes: int = number(8, 1, 1_000_000, "keyframes")

    def __post_init__(self) -> None:
        check_ranges(self)
        check_order(self, "last_scale_m", "first_scale_m")
