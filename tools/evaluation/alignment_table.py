"""The paper's table of alignments: pairs, translation and rotation for each scene and method, means and success."""
# Two errors are given: that of the paper, which is the error of the transform itself (its translation is measured at
# the origin of map b), and the error where the maps overlap, which is the one that matters to a robot.

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hickory_stream.alignment.answer import Alignment, NoAlignment
from hickory_stream.geometry.rigid import apply, invert, rotation_angle_rad

SUCCESS_M = 0.5
SUCCESS_DEG = 5.0


@dataclass(frozen=True, kw_only=True, slots=True)
class AlignmentError:
    """The error of an alignment: at the centroid of the true common objects, at map b's origin, and of the rotation."""

    translation_m: float
    origin_m: float
    rotation_deg: float

    @property
    def is_success(self) -> bool:
        """Whether it is below 0.5 m and 5 degrees."""
        return self.translation_m < SUCCESS_M and self.rotation_deg < SUCCESS_DEG


def error_of(
    a_from_b: NDArray[np.float64], true_a_from_b: NDArray[np.float64], center_b: NDArray[np.float64]
) -> AlignmentError:
    """Return the error of a transform; `center_b` (3,) is the centre of the overlap."""
    return AlignmentError(
        translation_m=float(np.linalg.norm(apply(a_from_b, center_b) - apply(true_a_from_b, center_b))),
        origin_m=float(np.linalg.norm(a_from_b[:3, 3] - true_a_from_b[:3, 3])),
        rotation_deg=float(np.degrees(rotation_angle_rad(a_from_b[:3, :3].T @ true_a_from_b[:3, :3]))),
    )


@dataclass(frozen=True, kw_only=True, slots=True)
class Row:
    """One scene by one method; `error` is None without a truth, or if the method refused for the reason `refusal`."""

    scene: str
    method: str
    num_pairs: int
    error: AlignmentError | None
    refusal: str | None


def row_of(scene: str, method: str, answer: Alignment | NoAlignment, true_a_from_b: NDArray[np.float64] | None) -> Row:
    if not isinstance(answer, Alignment):
        return Row(scene=scene, method=method, num_pairs=0, error=None, refusal=answer.refusal.value)
    error = None
    if true_a_from_b is not None:
        error = error_of(answer.a_from_b, true_a_from_b, apply(invert(true_a_from_b), answer.center_a))
    return Row(scene=scene, method=method, num_pairs=len(answer.pairs), error=error, refusal=None)


def format_table(rows: Sequence[Row]) -> str:
    """Return the table as text: a line for each scene and method, then the means of each method."""
    lines = [f"{'method':<10} {'scene':<28} {'N_a':>4} {'trans m':>9} {'rot deg':>8} {'overlap m':>10}  result"]
    lines += [_line(row) for row in rows]
    for method in dict.fromkeys(row.method for row in rows):
        lines.append(_mean_line(method, [row for row in rows if row.method == method]))
    return "\n".join(lines)


def table_json(rows: Sequence[Row]) -> list[dict[str, Any]]:
    return [
        {
            "scene": row.scene,
            "method": row.method,
            "num_pairs": row.num_pairs,
            "translation_m": None if row.error is None else row.error.origin_m,
            "rotation_deg": None if row.error is None else row.error.rotation_deg,
            "overlap_m": None if row.error is None else row.error.translation_m,
            "success": None if row.refusal is None and row.error is None else _is_success(row),
            "refusal": row.refusal,
        }
        for row in rows
    ]


def _is_success(row: Row) -> bool:
    return row.error is not None and row.error.is_success


def _line(row: Row) -> str:
    start = f"{row.method:<10} {row.scene:<28.28} {row.num_pairs:>4}"
    if row.error is None:
        return f"{start} {'-':>9} {'-':>8} {'-':>10}  {row.refusal or 'aligned, no truth given'}"
    errors = f"{row.error.origin_m:>9.4f} {row.error.rotation_deg:>8.4f} {row.error.translation_m:>10.4f}"
    return f"{start} {errors}  {'success' if row.error.is_success else 'WRONG'}"


def _mean_line(method: str, rows: Sequence[Row]) -> str:
    errors = [row.error for row in rows if row.error is not None]
    pairs = float(np.mean([row.num_pairs for row in rows]))
    start = f"{method:<10} {'mean':<28} {pairs:>4.1f}"
    found = f"{sum(map(_is_success, rows))} of {len(rows)}"
    if not errors:
        return f"{start} {'-':>9} {'-':>8} {'-':>10}  {found}"
    means = [
        float(np.mean([getattr(e, name) for e in errors])) for name in ("origin_m", "rotation_deg", "translation_m")
    ]
    return f"{start} {means[0]:>9.4f} {means[1]:>8.4f} {means[2]:>10.4f}  {found}"
