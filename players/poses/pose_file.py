"""Poses from a text file: TUM rows, or CSV whose header names its columns (`#timestamp_kf,x,y,z,qw,qx,qy,qz`).

A profile may describe the file. The unit of time follows from the size of the numbers.
"""

import re
from decimal import Decimal, InvalidOperation
from pathlib import Path

from hickory_stream.errors import RecordingError
from players.poses.interpolation import is_pose_row
from players.profile import PoseColumns

_TUM = PoseColumns(columns=("t", "x", "y", "z", "qx", "qy", "qz", "qw"), separator=" ", time_unit="")
_NEEDED = ("t", "x", "y", "z", "qx", "qy", "qz", "qw")
_ALIASES = {
    **dict.fromkeys(("timestamp", "time", "stamp", "timestamp_kf", "ts", "nsec", "timestamp_ns", "#timestamp"), "t"),
    **{f"{prefix}{axis}": axis for prefix in ("t", "p", "p_", "t_", "pos_", "position_") for axis in "xyz"},
    **{f"{prefix}{axis}": f"q{axis}" for prefix in ("q_", "rot_", "orientation_", "quat_") for axis in "xyzw"},
}
_UNITS_NS = {"s": 1_000_000_000, "ms": 1_000_000, "us": 1_000, "ns": 1}


def read_pose_file(file: Path, described: PoseColumns | None) -> tuple[list[int], list[list[float]]]:
    """Return stamps in ns and rows tx ty tz qx qy qz qw; rows that are no pose are left out.

    Raises `RecordingError`: the file cannot be read, its columns are not known, or no row of it is a pose.
    """
    try:
        lines = file.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise RecordingError(f"{file} cannot be read: {error}") from error
    layout = _layout(lines) or described or _TUM
    missing = [name for name in _NEEDED if name not in layout.columns]
    if missing:
        raise RecordingError(
            f"{file}: its columns are {', '.join(layout.columns)}; {', '.join(missing)} are missing. "
            "Describe them under [pose_file] in a profile"
        )
    places = [layout.columns.index(name) for name in _NEEDED]
    stamps, rows = [], []
    for line in lines:
        words = line.replace(layout.separator, " ").split() if layout.separator.strip() else line.split()
        try:
            time, *numbers = (words[place] for place in places)
            row = [float(number) for number in numbers]
            stamp = Decimal(time)
        except (ValueError, IndexError, InvalidOperation):
            continue
        if is_pose_row(row) and stamp.is_finite():
            stamps.append(stamp)
            rows.append(row)
    if not stamps:
        raise RecordingError(f"{file} holds no pose; expected rows of: {' '.join(layout.columns)}")
    unit_ns = _UNITS_NS.get(layout.time_unit) or _unit_ns(max(stamps))
    return [int(stamp * unit_ns) for stamp in stamps], rows


def _layout(lines: list[str]) -> PoseColumns | None:
    for line in lines[:20]:
        separator = "," if "," in line else ";" if ";" in line else " "
        words = [word.strip().lower() for word in line.lstrip("# ").split(separator if separator != " " else None)]
        names = tuple(_ALIASES.get(re.sub(r"\s*\[.*\]$", "", word), re.sub(r"\s*\[.*\]$", "", word)) for word in words)
        if sum(name in _NEEDED for name in names) >= 5:
            unit = next((hit.group(1) for word in words[:1] if (hit := re.search(r"\[(ns|us|ms|s)\]", word))), "")
            return PoseColumns(columns=names, separator=separator, time_unit=unit)
    return None


def _unit_ns(largest: Decimal) -> int:
    # Stamps since 1970 have a unit by their size; smaller numbers are seconds.
    return 1 if largest > 10**17 else 1_000 if largest > 10**14 else 1_000_000 if largest > 10**11 else 1_000_000_000
