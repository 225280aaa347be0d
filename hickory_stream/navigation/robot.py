"""Robot models: footprint, spheres and heights for each posture, read from TOML files.

A body is a few upright convex parts: corners (x forward), a disc around each, a ball around that, and two heights. A
cylinder is one corner with a disc, a footprint several corners, a sphere one corner at one height with a ball.
"""

import tomllib
from dataclasses import dataclass, field, replace
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.ranges import Range, Ranged, check_order, check_ranges, number, ranges_of, required
from hickory_stream.errors import ConfigError
from hickory_stream.geometry.arrays import freeze

_HEADINGS = 24
_MOST_POSTURES = 8

# The ranges of the numbers in a robot's file; a `Part` may also have heights in the world frame.
_IN_A_FILE = {
    "low_m": Range(low=0, high=100, unit="m"),
    "high_m": Range(low=0, high=100, unit="m"),
    "radius_m": Range(low=0, high=100, unit="m"),
    "footprint_m": Range(low=-100, high=100, unit="m"),
    "spheres_m": Range(low=-100, high=100, unit="m"),
}


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Part(Ranged):
    """A convex part of a body: `corners_m` (V, 2) in the robot's frame, heights above the floor, radii."""

    low_m: float = required(-1e4, 1e4, "m")
    high_m: float = required(-1e4, 1e4, "m")
    corners_m: NDArray[np.float64] = field(default_factory=lambda: np.zeros((1, 2)))
    disc_m: float = number(0.0, 0, 1000, "m")
    ball_m: float = number(0.0, 0, 1000, "m")

    def __post_init__(self) -> None:
        freeze(self, "corners_m", np.float64, (None, 2))
        check_ranges(self)
        check_order(self, "low_m", "high_m")
        if not (np.isfinite(self.corners_m).all() and len(self.corners_m)):
            raise ValueError("a part of a body has corners that are not finite, or none")

    @property
    def numbers(self) -> NDArray[np.float64]:
        """The (4,) low, high, disc, ball that the kernels take."""
        return np.array([self.low_m, self.high_m, self.disc_m, self.ball_m])

    @property
    def reach_m(self) -> float:
        """Its horizontal reach from the robot's centre."""
        return float(np.linalg.norm(self.corners_m, axis=1).max()) + self.disc_m + self.ball_m

    @property
    def is_round(self) -> bool:
        """Whether it is the same in every heading."""
        return not self.corners_m.any()


@dataclass(frozen=True, kw_only=True, slots=True)
class Posture(Ranged):
    """The parts of a body in one posture; a metre in it costs as much as `cost` metres in a posture of cost 1."""

    name: str
    parts: tuple[Part, ...]
    cost: float = number(1.0, 1, 1000, "ratio")

    @property
    def height_m(self) -> float:
        """Its height above the floor."""
        return max(part.high_m + part.ball_m for part in self.parts)


@dataclass(frozen=True, kw_only=True, slots=True)
class Robot(Ranged):
    """A robot that turns on the spot and drives straight, forwards or backwards; preferred postures come first."""

    name: str
    postures: tuple[Posture, ...]
    num_headings: int = number(1, 1, 360, "headings")

    @property
    def reach_m(self) -> float:
        """Its horizontal reach from its centre."""
        return max(part.reach_m for posture in self.postures for part in posture.parts)

    @property
    def heights_m(self) -> tuple[float, float]:
        """The least and greatest height above the floor, over all postures."""
        parts = [part for posture in self.postures for part in posture.parts]
        return min(part.low_m - part.ball_m for part in parts), max(part.high_m + part.ball_m for part in parts)

    def heading_rad(self, index: int) -> float:
        """Return the middle of a heading's range."""
        return 2 * np.pi * index / self.num_headings


def turned(part: Part, heading_rad: float, range_rad: float) -> Part:
    """Return the convex hull of a part over all headings within half of `range_rad` of `heading_rad`."""
    if part.is_round:
        return part
    half = range_rad / 2
    corners = [part.corners_m @ _rotation(heading_rad + a).T * s for a, s in ((-half, 1.0), (half, 1.0))]
    if half > 0:
        # The intersection of the tangents at both ends of a corner's arc.
        corners.append(part.corners_m @ _rotation(heading_rad).T / np.cos(half))
    return replace(part, corners_m=np.concatenate(corners))


def raised(part: Part, floor_z_m: float) -> Part:
    """Return a part with heights in the world frame instead of above the floor."""
    return replace(part, low_m=part.low_m + floor_z_m, high_m=part.high_m + floor_z_m)


def grown(part: Part, margin_m: float) -> Part:
    """Return a part that is larger by a margin on all sides."""
    return replace(part, ball_m=part.ball_m + margin_m)


def robot_names() -> tuple[str, ...]:
    """Return the names of the robots that come with the package."""
    return tuple(sorted(Path(entry.name).stem for entry in _folder().iterdir() if entry.name.endswith(".toml")))


def load_robot(name_or_path: str) -> Robot:
    """Return a robot of the package by its name, or of a TOML file.

    Raises:
        ConfigError: there is no such robot, or its file is invalid.
    """
    path = Path(name_or_path)
    if path.suffix == ".toml" or path.is_file():
        try:
            text = path.read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise ConfigError(f"cannot read the robot {path}: {error}") from error
    elif name_or_path in robot_names():
        text = (_folder() / f"{name_or_path}.toml").read_text(encoding="utf-8")
    else:
        known = ", ".join(robot_names())
        raise ConfigError(f"found no robot {name_or_path}; known are {known}, or name a file FILE.toml")
    try:
        return robot_of(tomllib.loads(text), default_name=path.stem)
    except (ValueError, TypeError, KeyError, AttributeError, OverflowError, RecursionError) as error:
        message = f"misses the key {error}" if isinstance(error, KeyError) else str(error)
        raise ConfigError(f"robot {name_or_path}: {message}; see the robots that come with the package") from error


def robot_of(record: dict[str, Any], default_name: str = "robot") -> Robot:
    """Return the robot of a parsed TOML file; raises ValueError, TypeError or KeyError if it is invalid."""
    _only(record, {"name", "description", "num_headings", "posture"})
    found = record["posture"]
    if not isinstance(found, list) or not 1 <= len(found) <= _MOST_POSTURES:
        raise ValueError(f"expected 1 to {_MOST_POSTURES} tables [[posture]]")
    postures = tuple(_posture_of(item) for item in found)
    is_round = all(part.is_round for posture in postures for part in posture.parts)
    headings = record.get("num_headings", 1 if is_round else _HEADINGS)
    ranges_of(Robot)["num_headings"].check("num_headings", headings)
    if headings < 8 and not is_round:
        raise ValueError(f"found num_headings = {headings}, expected 8 to 360, or 1 for a round robot")
    return Robot(name=str(record.get("name", default_name)), postures=postures, num_headings=headings)


def _posture_of(record: dict[str, Any]) -> Posture:
    _only(record, {"name", "low_m", "high_m", "radius_m", "footprint_m", "spheres_m", "cost"})
    for key, limits in _IN_A_FILE.items():
        for value in record[key] if isinstance(record.get(key), list) else [record.get(key, limits.low)]:
            limits.check(key, value)
    if "spheres_m" in record:
        parts = tuple(
            Part(low_m=z, high_m=z, corners_m=np.array([[x, y]]), ball_m=radius)
            for x, y, z, radius in (tuple(map(float, sphere)) for sphere in record["spheres_m"])
        )
        if not parts:
            raise ValueError("spheres_m is empty, expected [[x, y, z, radius], ...]")
    else:
        corners = np.array(record.get("footprint_m", [[0.0, 0.0]]), dtype=np.float64)
        parts = (
            Part(
                low_m=float(record["low_m"]),
                high_m=float(record["high_m"]),
                corners_m=corners,
                disc_m=float(record.get("radius_m", 0.0)),
            ),
        )
    return Posture(name=str(record["name"]), parts=parts, cost=record.get("cost", 1.0))


def _only(record: dict[str, Any], known: set[str]) -> None:
    unknown = sorted(set(record) - known)
    if unknown:
        raise ValueError(f"unknown key {unknown[0]}, expected some of {', '.join(sorted(known))}")


def _rotation(angle_rad: float) -> NDArray[np.float64]:
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([[c, -s], [s, c]])


def _folder() -> Any:
    return resources.files("hickory_stream.navigation") / "robots"
