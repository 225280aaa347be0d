"""Text files of image folders: intrinsics, poses, gravity, lists of stamped images."""

import json
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from decimal import Decimal, InvalidOperation
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hickory_stream.errors import CalibrationError, InputError, RecordingError
from hickory_stream.geometry import portable
from hickory_stream.geometry.rigid import invert
from players.poses.interpolation import PoseTrack, is_pose_row, nearest_rigid, track_of, world_from_down
from players.profile import Intrinsics

GRAVITY = "gravity-direction.txt"


@contextmanager
def expecting(file: Path, expected: str, error: type[InputError] = RecordingError) -> Iterator[None]:
    """Turn whatever a malformed value raises into an error with the file, the value and what was expected."""
    try:
        yield
    except (KeyError, TypeError, ValueError, IndexError, AttributeError, ArithmeticError, RecursionError) as cause:
        raise error(f"{file}: {cause!r:.200}; expected {expected}") from cause


def read_text(file: Path) -> str:
    """Return the text of a file. Raises `RecordingError`: it cannot be read, or holds no text."""
    try:
        return file.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise RecordingError(f"{file} cannot be read: {error}") from error


def read_numbers(file: Path) -> NDArray[np.float64]:
    """Return all numbers of a file (N,), separated by space or commas.

    Raises `RecordingError`: something in it is no number.
    """
    try:
        return np.array([float(word) for word in read_text(file).replace(",", " ").split()])
    except ValueError as error:
        raise RecordingError(f"{file}: {error}; expected numbers") from error


def read_intrinsics(file: Path) -> Intrinsics:
    """Return the intrinsics of a text file with a 3x3 or 4x4 matrix K, row by row.

    Raises `CalibrationError`: the file is missing or holds no such matrix.
    """
    if not file.is_file():
        raise CalibrationError(f"{file.parent} has no {file.name}; it must hold the 3x3 intrinsics of the depth camera")
    numbers = read_numbers(file)
    if numbers.size not in (9, 16):
        raise CalibrationError(f"{file}: {numbers.size} numbers; expected a 3x3 matrix with positive focal lengths")
    with expecting(file, "a 3x3 matrix with positive focal lengths", CalibrationError):
        return intrinsics_of(numbers)


def intrinsics_of(numbers: Any) -> Intrinsics:
    """Return the intrinsics of a 3x3 or 4x4 matrix K, or of its numbers by rows. Raises `ValueError`: it is none."""
    flat = np.asarray(numbers, dtype=np.float64).ravel()
    k = flat.reshape(3 if flat.size == 9 else 4, -1)
    return Intrinsics(fx=float(k[0, 0]), fy=float(k[1, 1]), cx=float(k[0, 2]), cy=float(k[1, 2]))


def resized(of: Intrinsics, size: tuple[int, int], new: tuple[int, int]) -> Intrinsics:
    """Return the intrinsics of images of `size` (width, height) for the same view in `new` pixels."""
    # Pixel centres are at integer coordinates.
    x, y = new[0] / size[0], new[1] / size[1]
    return Intrinsics(fx=of.fx * x, fy=of.fy * y, cx=(of.cx + 0.5) * x - 0.5, cy=(of.cy + 0.5) * y - 0.5)


def read_cam_params(file: Path) -> tuple[Intrinsics, float]:
    """Return the intrinsics and the depth units per metre of a `cam_params.json`.

    Accepted are fx, fy, cx, cy or a 3x3 K, and w and h, at the top or under `camera`; `scale`, `depth_scale` or
    `depth_units_per_m` (default 1000).

    Raises `CalibrationError`: the file cannot be read or a value is missing.
    """
    with expecting(file, "fx, fy, cx, cy (or K) and scale, in JSON", CalibrationError):
        table: dict[str, Any] = json.loads(read_text(file))
        table = table.get("camera", table)
        if "K" in table:
            (fx, _, cx), (_, fy, cy) = np.asarray(table["K"], dtype=np.float64).reshape(3, 3)[:2].tolist()
        else:
            fx, fy, cx, cy = (float(table[name]) for name in ("fx", "fy", "cx", "cy"))
        sides = [int(table.get(side[0], table.get(side)) or 0) for side in ("width", "height")]
        width, height = sides if all(sides) else (None, None)
        names = ("depth_units_per_m", "depth_scale", "scale")
        units_per_m = next((float(table[name]) for name in names if name in table), 1000.0)
    # Some files give the scale as metres per unit, which is below one.
    units_per_m = 1.0 / units_per_m if 0 < units_per_m < 1 else units_per_m
    if not (fx > 0 and fy > 0 and units_per_m > 0):
        raise CalibrationError(f"{file}: fx {fx}, fy {fy}, scale {units_per_m}; all must be positive")
    return Intrinsics(fx=fx, fy=fy, cx=cx, cy=cy, width=width, height=height), units_per_m


def read_world_from_log(folder: Path) -> NDArray[np.float64]:
    """Return the rotation (4, 4) that turns z up: from `gravity-direction.txt`, else the identity.

    Raises `RecordingError`: the file holds no direction.
    """
    file = folder / GRAVITY
    if not file.is_file():
        return np.eye(4)
    down = read_numbers(file)
    if down.shape != (3,) or not 0.5 < portable.norm(down) < 2.0:
        raise RecordingError(f"{file} must hold the unit vector down in the world; found {down}")
    return world_from_down(down)


def read_pose_file(file: Path) -> NDArray[np.float64] | None:
    """Return the pose of a file with a 4x4 or 3x4 matrix, None if it is invalid (NaN where tracking was lost)."""
    return rigid_of(read_numbers(file))


def read_hope_camera(file: Path, units_per_m: float) -> tuple[Intrinsics, NDArray[np.float64] | None]:
    """Return the intrinsics and world_from_camera (4, 4) of a HOPE json; None if its extrinsics are no rigid transform.

    Raises `CalibrationError`: it cannot be read, or has no intrinsics.
    """
    expected = "camera.intrinsics (3x3) and camera.extrinsics (4x4, camera from world)"
    with expecting(file, expected, CalibrationError):
        camera = json.loads(read_text(file))["camera"]
        k = np.asarray(camera["intrinsics"], dtype=np.float64).reshape(3, 3)
        camera_from_world = np.asarray(camera["extrinsics"], dtype=np.float64).reshape(4, 4)
    intrinsics = Intrinsics(fx=float(k[0, 0]), fy=float(k[1, 1]), cx=float(k[0, 2]), cy=float(k[1, 2]))
    rigid = nearest_rigid(camera_from_world)
    if rigid is None or not (k[0, 0] > 0 and k[1, 1] > 0):
        return intrinsics, None
    rigid[:3, 3] /= units_per_m
    return intrinsics, invert(rigid)


def read_pose_rows(file: Path) -> list[NDArray[np.float64] | None]:
    """Return a pose per line of 16 or 12 numbers, row by row; None for a line that is no rigid transform.

    Raises `RecordingError`: a line has another number of numbers.
    """
    poses = []
    for number, line in enumerate(read_text(file).splitlines(), start=1):
        if not line.strip() or line.startswith("#"):
            continue
        try:
            row = np.array([float(word) for word in line.replace(",", " ").split()])
        except ValueError as error:
            raise RecordingError(f"{file}, line {number}: {error}; expected 16 or 12 numbers") from error
        if row.size not in (12, 16):
            raise RecordingError(
                f"{file}, line {number}: {row.size} numbers; expected 16 or 12, world_from_camera by rows"
            )
        poses.append(rigid_of(row))
    return poses


def read_stamped_rows(file: Path, columns: int) -> list[tuple[int, list[str]]]:
    """Return the rows of a TUM list: the stamp in nanoseconds, exactly, and the words behind it.

    Raises `RecordingError`: a row has fewer columns, or does not begin with seconds.
    """
    rows = []
    for number, line in enumerate(read_text(file).splitlines(), start=1):
        words = line.split()
        if not words or line.startswith("#"):
            continue
        try:
            stamp_ns = int(Decimal(words[0]) * 1_000_000_000)
        except (InvalidOperation, ValueError, OverflowError) as error:
            raise RecordingError(f"{file}, line {number}: {words[0]!r} is no stamp in seconds") from error
        if len(words) < columns:
            raise RecordingError(f"{file}, line {number}: {len(words)} columns; expected {columns}")
        rows.append((stamp_ns, words[1:]))
    return rows


def read_tum_track(file: Path, max_gap_ns: int) -> PoseTrack:
    """Return the trajectory of a TUM file: `stamp tx ty tz qx qy qz qw`; rows that are no pose are left out.

    Raises `RecordingError`: no row is a pose.
    """
    stamps_ns, rows = [], []
    for stamp_ns, words in read_stamped_rows(file, 8):
        with suppress(ValueError):
            row = [float(word) for word in words[:7]]
            if is_pose_row(row):
                stamps_ns.append(stamp_ns)
                rows.append(row)
    track = track_of(stamps_ns, rows, max_gap_ns)
    if track is None:
        raise RecordingError(f"{file} holds no pose; expected rows of: stamp tx ty tz qx qy qz qw")
    return track


def rigid_of(numbers: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """Return the transform (4, 4) of 16 or 12 numbers by rows, None if they are no rigid transform."""
    return nearest_rigid(numbers.reshape(-1, 4)[:3]) if numbers.size in (12, 16) else None
