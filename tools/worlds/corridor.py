"""Scans of a LiDAR with 32 beams in an empty box: a corridor, which does not constrain motion along it, or a room."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry.rigid import apply, from_rotation_translation, invert, yaw_rotation
from hickory_stream.records import Scan

_HEIGHT_M, _SENSOR_M = 2.5, 0.6


@dataclass(frozen=True, kw_only=True, slots=True)
class CorridorConfig:
    """A walk with a gentle sway through a box, `length_m` along x and `width_m` along y."""

    length_m: float = 30.0
    width_m: float = 2.0
    #: From the box's end to the start of the walk.
    margin_m: float = 6.0
    way_m: float = 18.0
    speed_mps: float = 1.0
    rate_hz: float = 10.0
    beams: int = 32
    columns: int = 720
    range_m: float = 30.0
    sigma_m: float = 0.02


def corridor_scans(config: CorridorConfig, seed: int) -> list[tuple[Scan, NDArray[np.float64]]]:
    """Return the scans of a walk, each with the true pose (4, 4) of the sensor in the box's frame."""
    rng = np.random.default_rng([seed, 32])
    count = int(config.way_m / config.speed_mps * config.rate_hz) + 1
    scans = []
    for i in range(count):
        x = config.margin_m + i * config.speed_mps / config.rate_hz
        sway = 2.0 * np.pi * (x - config.margin_m) / 9.0
        world_from_sensor = from_rotation_translation(
            yaw_rotation(0.08 * float(np.cos(sway))), np.array([x, 0.1 * float(np.sin(sway)), _SENSOR_M])
        )
        stamp_ns = round(i * 1e9 / config.rate_hz)
        points = scan_from(world_from_sensor, config, rng)
        scans.append((Scan(stamp_ns=stamp_ns, frame="lidar", points=points), world_from_sensor))
    return scans


def scan_from(
    world_from_sensor: NDArray[np.float64], config: CorridorConfig, rng: np.random.Generator
) -> NDArray[np.float32]:
    """Return the points (N, 3) that a sensor at a pose (4, 4) within the box sees, in its own frame."""
    rays = _directions(config) @ world_from_sensor[:3, :3].T
    ranges = _ranges(world_from_sensor[:3, 3], rays, config) + config.sigma_m * rng.standard_normal(len(rays))
    points_world = world_from_sensor[:3, 3] + rays * ranges[:, None]
    return apply(invert(world_from_sensor), points_world[ranges < config.range_m]).astype(np.float32)


def _directions(config: CorridorConfig) -> NDArray[np.float64]:
    # Rays (N, 3) of a Velodyne HDL-32E: from 10.67 degrees up to 30.67 down.
    elevation = np.radians(np.linspace(-30.67, 10.67, config.beams))[:, None]
    azimuth = np.linspace(-np.pi, np.pi, config.columns, endpoint=False)[None, :]
    flat = np.cos(elevation)
    rays = np.stack(
        [
            flat * np.cos(azimuth),
            flat * np.sin(azimuth),
            np.broadcast_to(np.sin(elevation), (len(elevation), azimuth.size)),
        ],
        axis=-1,
    )
    return rays.reshape(-1, 3)


def _ranges(origin: NDArray[np.float64], rays: NDArray[np.float64], config: CorridorConfig) -> NDArray[np.float64]:
    low = np.array([0.0, -config.width_m / 2, 0.0])
    high = np.array([config.length_m, config.width_m / 2, _HEIGHT_M])
    with np.errstate(divide="ignore", invalid="ignore"):
        ends = np.where(rays > 0, (high - origin) / rays, np.where(rays < 0, (low - origin) / rays, np.inf))
    return ends.min(axis=1)
