"""Calibration that a folder does not hold, from `players/profiles/*.toml`; each file explains its values."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hickory_stream.errors import CalibrationError
from hickory_stream.geometry.camera import Camera

_FOLDER = Path(__file__).parent / "profiles"


@dataclass(frozen=True, kw_only=True, slots=True)
class Intrinsics:
    """A pinhole without its image size, in pixels."""

    fx: float
    fy: float
    cx: float
    cy: float

    def camera(self, size: tuple[int, int]) -> Camera:
        """Return the camera of images of (width, height)."""
        return Camera(width=size[0], height=size[1], fx=self.fx, fy=self.fy, cx=self.cx, cy=self.cy)


@dataclass(frozen=True, kw_only=True, slots=True)
class Profile:
    """The calibration of a folder.

    `color` are the intrinsics of a colour camera that is not the depth camera; `color_from_depth_m` the translation
    between the two, in metres: P_color = P_depth + color_from_depth_m.
    """

    depth_units_per_m: float = 1000.0
    frame_rate_hz: int = 30
    color: Intrinsics | None = None
    color_from_depth_m: tuple[float, float, float] = (0.0, 0.0, 0.0)


def load_profile(name_or_path: str) -> Profile:
    """Return a profile by its name among those that come with the players, or from a TOML file.

    Raises:
        CalibrationError: there is no such profile, or a key or value in it is wrong.
    """
    built_in = _FOLDER / f"{name_or_path}.toml"
    path = built_in if built_in.is_file() else Path(name_or_path)
    try:
        return _parse(tomllib.loads(path.read_text(encoding="utf-8")))
    except OSError as error:
        names = ", ".join(sorted(file.stem for file in _FOLDER.glob("*.toml")))
        raise CalibrationError(f"no profile {name_or_path!r}; there are {names}, or name a TOML file") from error
    except (tomllib.TOMLDecodeError, TypeError, ValueError) as error:
        raise CalibrationError(f"profile {path}: {error}; compare it with {_FOLDER.name}/7scenes.toml") from error


def _parse(table: dict[str, Any]) -> Profile:
    """Return the profile of a TOML table; keys that are no field raise TypeError."""
    color = table.pop("color", None)
    x, y, z = (float(part) for part in table.pop("color_from_depth_m", (0.0, 0.0, 0.0)))
    profile = Profile(**table, color=Intrinsics(**color) if color else None, color_from_depth_m=(x, y, z))
    if not (profile.depth_units_per_m > 0 and profile.frame_rate_hz > 0):
        raise ValueError("depth_units_per_m and frame_rate_hz must be positive")
    return profile
