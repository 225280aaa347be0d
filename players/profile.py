"""Profiles of data sets and robots (`players/profiles/*.toml`): what their logs do not contain.

A profile names topics, links between body and camera, and tolerances. Topics identify it, or `--profile`.
"""

import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.json_text import dumps_exactly, toml_string
from hickory_stream.base.ranges import Range, Ranged, number, required
from hickory_stream.errors import CalibrationError
from hickory_stream.geometry import portable
from hickory_stream.geometry.camera import Camera
from hickory_stream.geometry.depth_sensor import DepthSensor
from hickory_stream.geometry.rigid import compose, from_rotation_translation, invert, rotation_from_quaternion
from players.logs.containers import Topic
from players.options import MAX_GAP_NS
from players.poses.interpolation import nearest_rigid
from players.poses.tf import Edge
from players.poses.tracks import JumpLimits

_TOLERANCE = Range(low=0.001, high=MAX_GAP_NS / 1e6, unit="ms")
_OFFSET = Range(low=-1000, high=1000, unit="m")
_COMPONENT = Range(low=-2, high=2, unit="for a component")

# Larger offsets are those of a clock that was not set.
_OFFSET_MS = Range(low=-60_000, high=60_000, unit="ms")
_SCALE = Range(low=1e-5, high=1e5, unit="m per unit as read")

_FOLDER = Path(__file__).parent / "profiles"
_ROLES = ("color", "depth", "color_info", "depth_info", "pose")

OPTICAL_FROM_FLU = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
"""The rotation of optical axes (x right, y down, z forward) into body axes of ROS (x forward, y left, z up)."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Intrinsics(Ranged):
    """Pinhole intrinsics in pixels; `width` and `height` of their images may be unknown."""

    fx: float = required(1e-3, 1e6, "px")
    fy: float = required(1e-3, 1e6, "px")
    cx: float = required(-1e6, 1e6, "px")
    cy: float = required(-1e6, 1e6, "px")
    width: int | None = number(None, 1, 65_535, "px")
    height: int | None = number(None, 1, 65_535, "px")

    def camera(self, size: tuple[int, int], where: str = "intrinsics") -> Camera:
        """Return the camera of images of (width, height), which may have been resized.

        Raises `CalibrationError`: they cannot have been, or their middle is far from the principal point.
        """
        from players.messages.calibration import check_center, has_shape, scaled

        width, height = self.width or size[0], self.height or size[1]
        camera = Camera(width=width, height=height, fx=self.fx, fy=self.fy, cx=self.cx, cy=self.cy)
        if not has_shape(camera, size):
            raise CalibrationError(
                f"{where}: the intrinsics are of images of {width}x{height} pixels, those of {size[0]}x{size[1]} have "
                "another ratio of sides; add their own as camera-intrinsics.txt or cam_params.json"
            )
        check_center(camera, where)
        return scaled(camera, size)

    def of_nearest(self, sizes: Sequence[tuple[int, int]]) -> Self:
        """Return them with a size: their own, or of several the one whose middle is nearest to the principal point."""
        if self.width is not None:
            return self
        width, height = min(sizes, key=lambda s: abs((self.cx + 0.5) / s[0] - 0.5) + abs((self.cy + 0.5) / s[1] - 0.5))
        return replace(self, width=width, height=height)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Corrections:
    """Mends of faults of a log: `doctor --fix` writes them."""

    #: Depth as read, times this, is in metres.
    depth_scale: float = 1.0
    #: (3, 3) the image's right, down and forward as columns in the frame that the log names; None is right already.
    frame_from_optical: NDArray[np.float64] | None = None
    #: Added to the stamps of the poses, and of the depth images.
    pose_offset_ns: int = 0
    depth_offset_ns: int = 0

    def turned(self, world_from_frame: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return `world_from_camera` (4, 4) of the pose of the frame that the log names."""
        if self.frame_from_optical is None:
            return world_from_frame
        return compose(world_from_frame, from_rotation_translation(self.frame_from_optical, np.zeros(3)))

    def between(self, color_from_depth: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the link (4, 4) between the cameras of two such frames."""
        return invert(self.turned(invert(self.turned(color_from_depth))))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class RigLinks:
    """The rig of a data set without TF: static links in a tree of their own, with the `body` of the pose topic."""

    body: str
    color: str
    depth: str
    links: tuple[Edge, ...]
    #: The frame of the point clouds, "" if none is connected.
    lidar: str = ""


@dataclass(frozen=True, kw_only=True, slots=True)
class PoseColumns:
    """The format of a text file of poses: names of columns (`t x y z qx qy qz qw`, others skipped), unit of time."""

    columns: tuple[str, ...]
    separator: str
    time_unit: str


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Profile(Ranged):
    """The properties of a kind of log."""

    name: str = ""
    title: str = ""
    depth_units_per_m: float = number(1000.0, 1e-3, 1e9, "1/m")
    #: Noise model of the depth camera.
    sensor: DepthSensor = field(default_factory=DepthSensor)
    frame_rate_hz: int = number(30, 1, 1000, "Hz")
    extrinsics_units_per_m: float = number(1.0, 1e-3, 1e9, "1/m")
    #: Intrinsics of a colour camera separate from the depth camera (folders).
    color: Intrinsics | None = None
    #: Usual intrinsics of the depth camera, for an image without a folder.
    depth: Intrinsics | None = None
    #: P_color = P_depth + color_from_depth_m (folders).
    color_from_depth_m: tuple[float, float, float] = number((0.0, 0.0, 0.0), -100, 100, "m")
    #: By role; the first that the log has is used.
    topics: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    rig: RigLinks | None = None
    sync_tolerance_ns: int | None = number(None, 1, MAX_GAP_NS, "ns")
    max_pose_gap_ns: int | None = number(None, 1, MAX_GAP_NS, "ns")
    jump_limits: JumpLimits = field(default_factory=JumpLimits)
    corrections: Corrections = field(default_factory=Corrections)
    pose_file: PoseColumns | None = None
    #: Values of `{robot}` and other placeholders.
    parameters: Mapping[str, str] = field(default_factory=dict)
    patterns: tuple[str, ...] = ()

    @property
    def has_robots(self) -> bool:
        """Whether its topics contain the name of a robot."""
        return _name_robots(self.patterns)


def load_profile(name_or_path: str, topics: Sequence[Topic] = (), robot: str | None = None) -> Profile:
    """Return a profile by name or TOML file; `{robot}` is `robot`, or the name found in the `topics`.

    Raises `CalibrationError`: there is no such profile, a key or value in it is wrong, or its robot is not known.
    """
    built_in = _FOLDER / f"{name_or_path}.toml"
    path = built_in if built_in.is_file() else Path(name_or_path)
    try:
        table = _table_of(path)
        parameters = _match(table, topics) or {}
        if robot is not None:
            parameters["robot"] = robot
        return _parse(path.stem, table, parameters)
    except OSError as error:
        raise CalibrationError(
            f"no profile {name_or_path!r}; there are {', '.join(profile_names())}, or name a TOML file"
        ) from error
    except (TypeError, ValueError, KeyError, AttributeError, OverflowError, RecursionError) as error:
        detail = f"{error} is missing" if isinstance(error, KeyError) else str(error)
        raise CalibrationError(f"profile {path}: {detail}; compare it with {_FOLDER.name}/seven_scenes.toml") from error


def _table_of(path: Path) -> dict[str, Any]:
    # The tables of a profile complete those of its `base`.
    table = tomllib.loads(path.read_text(encoding="utf-8"))
    if "base" not in table:
        return table
    name = table.pop("base")
    if name not in profile_names():
        raise ValueError(f"base {name!r}; expected one of {', '.join(profile_names())}")
    base = tomllib.loads((_FOLDER / f"{name}.toml").read_text(encoding="utf-8"))
    return {**base, **{k: {**base[k], **v} if isinstance(v, dict) and k in base else v for k, v in table.items()}}


def mended_profile(base: str, fixes: Mapping[str, Any]) -> str:
    """Return a profile as TOML: that of a name or file, with some lines of its own and of its tables replaced."""
    table: dict[str, Any] = (
        {"base": base} if base in profile_names() else _table_of(Path(base)) if Path(base).is_file() else {}
    )
    merged = {**table, **{k: {**table.get(k, {}), **v} if isinstance(v, dict) else v for k, v in fixes.items()}}
    plain = [f"{key} = {_toml(value)}" for key, value in merged.items() if not isinstance(value, dict)]
    tables = [line for key, value in merged.items() if isinstance(value, dict) for line in _table_lines(key, value)]
    return "\n".join([*plain, *tables]) + "\n"


def _table_lines(name: str, table: Mapping[str, Any]) -> list[str]:
    return ["", f"[{name}]", *(f"{key} = {_toml(value)}" for key, value in table.items())]


def _toml(value: object) -> str:
    # TOML writes strings, numbers and lists as JSON does, and a table within a line with `=`.
    if isinstance(value, dict):
        return "{" + ", ".join(f"{toml_string(key)} = {_toml(part)}" for key, part in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(_toml, value)) + "]"
    return toml_string(value) if isinstance(value, str) else dumps_exactly(value)


def profile_names() -> tuple[str, ...]:
    """Return the names of the profiles that come with the players."""
    return tuple(sorted(file.stem for file in _FOLDER.glob("*.toml")))


def profiles_with_robots() -> tuple[str, ...]:
    """Return the names of the profiles whose topics contain the name of a robot."""
    tables = {name: tomllib.loads((_FOLDER / f"{name}.toml").read_text(encoding="utf-8")) for name in profile_names()}
    return tuple(name for name, table in tables.items() if _name_robots(table.get("match", {}).get("topics", ())))


def robots_in(topics: Sequence[Topic], profile: Profile) -> tuple[str, ...]:
    """Return the robots whose topics, by the pattern of a profile, are in the log."""
    hits = [re.fullmatch(pattern, topic.name) for pattern in profile.patterns for topic in topics]
    return tuple(sorted({hit["robot"] for hit in hits if hit is not None and "robot" in hit.groupdict()}))


def guess_profile(topics: Sequence[Topic], robot: str | None = None) -> Profile | None:
    """Return the profile whose topics are all in the log, of several the most demanding one; None if none fits."""
    found = []
    for name in profile_names():
        table = tomllib.loads((_FOLDER / f"{name}.toml").read_text(encoding="utf-8"))
        if _match(table, topics) is not None:
            found.append((len(table["match"]["topics"]), name))
    return load_profile(max(found)[1], topics, robot) if found else None


def _name_robots(patterns: Sequence[str]) -> bool:
    return any("(?P<robot>" in pattern for pattern in patterns)


def _match(table: Mapping[str, Any], topics: Sequence[Topic]) -> dict[str, str] | None:
    patterns = table.get("match", {}).get("topics", [])
    parameters: dict[str, str] = {}
    for pattern in patterns:
        # The most frequent of several robots: a log of one robot may hold a few messages of its neighbours.
        hits = [
            (topic.num_messages or 0, topic.name, hit) for topic in topics if (hit := re.fullmatch(pattern, topic.name))
        ]
        same = [entry for entry in hits if all(parameters.get(k, v) == v for k, v in entry[2].groupdict().items())]
        if not same:
            return None
        parameters.update({key: value for key, value in max(same, key=lambda e: e[:2])[2].groupdict().items() if value})
    return parameters if patterns else None


def _parse(name: str, table: dict[str, Any], parameters: dict[str, str]) -> Profile:
    patterns = tuple(table.pop("match", {}).get("topics", ()))
    color, depth = table.pop("color", None), table.pop("depth", None)
    sensor, time = table.pop("sensor", {}), table.pop("time", {})
    rig, robots = table.pop("rig", None), table.pop("robots", {})
    topics = {role: _filled(table.get("streams", {}).get(role, ()), parameters) for role in _ROLES}
    unknown = table.pop("streams", {}).keys() - set(_ROLES)
    if unknown:
        raise TypeError(f"streams: unknown {', '.join(sorted(unknown))}; expected {', '.join(_ROLES)}")
    x, y, z = (float(part) for part in table.pop("color_from_depth_m", (0.0, 0.0, 0.0)))
    columns = table.pop("pose_file", None)
    corrections = Corrections(
        depth_scale=_scale(table.pop("depth_scale", 1.0)),
        frame_from_optical=_axes(table.pop("camera_axes", "x y z")),
        pose_offset_ns=_ns(time, "pose_offset_ms", _OFFSET_MS) or 0,
        depth_offset_ns=_ns(time, "depth_offset_ms", _OFFSET_MS) or 0,
    )
    profile = Profile(
        **table,
        name=name,
        sensor=DepthSensor(**sensor),
        color=Intrinsics(**color) if color else None,
        depth=Intrinsics(**depth) if depth else None,
        color_from_depth_m=(x, y, z),
        topics={role: names for role, names in topics.items() if names},
        rig=_rig(rig, robots, parameters) if rig else None,
        sync_tolerance_ns=_ns(time, "sync_tolerance_ms"),
        max_pose_gap_ns=_ns(time, "max_pose_gap_ms"),
        jump_limits=JumpLimits(**{f.name: float(time.pop(f.name)) for f in fields(JumpLimits) if f.name in time}),
        corrections=corrections,
        pose_file=PoseColumns(**{**columns, "columns": tuple(columns["columns"])}) if columns else None,
        parameters=parameters,
        patterns=patterns,
    )
    if time:
        raise TypeError(f"time: unknown {', '.join(sorted(time))}")
    return profile


def _scale(value: float) -> float:
    _SCALE.check("depth_scale", value)
    return float(value)


def _axes(text: str) -> NDArray[np.float64] | None:
    columns = [np.eye(3)["xyz".index(axis[-1])] * (-1.0 if axis[0] == "-" else 1.0) for axis in text.split()]
    axes = np.array(columns).T
    if axes.shape != (3, 3) or not portable.det3(axes) > 0.5:
        raise ValueError(f"camera_axes {text!r}; expected the image's right, down and forward, such as '-y -z x'")
    return None if np.array_equal(axes, np.eye(3)) else axes


def _ns(time: dict[str, Any], name: str, limits: Range = _TOLERANCE) -> int | None:
    # Removes the value from `time`.
    if name not in time:
        return None
    limits.check(name, time[name])
    return round(time.pop(name) * 1e6)


def _filled(names: Sequence[str] | str, parameters: Mapping[str, str]) -> tuple[str, ...]:
    # Names with unknown parameters are left out.
    names = (names,) if isinstance(names, str) else names
    known = (name for name in names if all(word in parameters for word in re.findall(r"\{(\w+)\}", name)))
    return tuple(re.sub(r"\{(\w+)\}", lambda hit: parameters[hit.group(1)], name) for name in known)


def _rig(rig: Mapping[str, Any], robots: Mapping[str, Any], parameters: Mapping[str, str]) -> RigLinks:
    links = [*rig.get("links", ())]
    if robots:
        robot = parameters.get("robot", "")
        if robot not in robots:
            raise ValueError(f"robot {robot!r} is not known; expected one of {', '.join(robots)}: name it with --robot")
        links += robots[robot]["links"]
    edges = tuple(Edge(parent=k["parent"], child=k["child"], parent_from_child=_transform(k)) for k in links)
    return RigLinks(
        body=rig["body"], color=rig["color"], depth=rig["depth"], links=edges, lidar=str(rig.get("lidar", ""))
    )


def _transform(link: Mapping[str, Any]) -> NDArray[np.float64]:
    if "matrix" in link:
        rigid = nearest_rigid(np.asarray(link["matrix"], dtype=np.float64))
        if rigid is None:
            raise ValueError(f"the matrix from {link['child']} to {link['parent']} is no rigid transform")
        _OFFSET.check("the translation of a matrix", rigid[:3, 3].tolist())
        return rigid
    rotation = np.eye(3)
    if "quaternion_xyzw" in link:
        _COMPONENT.check("quaternion_xyzw", link["quaternion_xyzw"])
        rotation = rotation_from_quaternion(*(float(part) for part in link["quaternion_xyzw"]))
    elif link.get("axes") == "flu_from_optical":
        rotation = OPTICAL_FROM_FLU.T
    elif "axes" in link:
        raise ValueError(f"axes {link['axes']!r}; expected flu_from_optical")
    translation_m = link.get("translation_m", (0, 0, 0))
    _OFFSET.check("translation_m", translation_m)
    return from_rotation_translation(rotation, np.asarray(translation_m, dtype=np.float64))
