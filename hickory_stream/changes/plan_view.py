"""A plan from above as SVG: footprints of objects in the colours of what became of them, and where they moved."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from hickory_stream.records import TrackedObject

_WIDTH_PX = 900
_MARGIN_M = 0.4
_SIGNS = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])


@dataclass(frozen=True, kw_only=True, slots=True)
class Footprint:
    """An object on the plan; dashed is what the later map says."""

    item: TrackedObject
    color: str
    is_dashed: bool


def plan_svg(
    footprints: Sequence[Footprint], moves: Sequence[tuple[TrackedObject, TrackedObject, str]], told: str
) -> str:
    """Return the plan, "" without an object; of `moves` the centres are joined by a line, `told` is its caption."""
    if not footprints:
        return ""
    corners = np.concatenate([one.item.box.corners_world()[:, :2] for one in footprints])
    low, high = corners.min(axis=0) - _MARGIN_M, corners.max(axis=0) + _MARGIN_M
    scale = _WIDTH_PX / float(high[0] - low[0])

    def at(point: NDArray[np.float64]) -> tuple[float, float]:
        return float((point[0] - low[0]) * scale), float((high[1] - point[1]) * scale)

    drawn = []
    for one in footprints:
        box, color = one.item.box, one.color
        outline = box.center[:2] + (box.half_extents_m[:2] * _SIGNS) @ box.world_from_box[:2, :2].T
        points = " ".join(f"{x:.1f},{y:.1f}" for x, y in map(at, outline))
        dash = ' stroke-dasharray="5 4"' if one.is_dashed else ""
        drawn.append(f'<polygon points="{points}" fill="{color}" fill-opacity=".25" stroke="{color}"{dash}/>')
        x, y = at(box.center)
        drawn.append(f'<text x="{x:.1f}" y="{y:.1f}" font-size="13" fill="{color}">{one.item.id}</text>')
    for a, b, color in moves:
        (x0, y0), (x1, y1) = at(a.box.center), at(b.box.center)
        drawn.append(
            f'<line x1="{x0:.1f}" y1="{y0:.1f}" x2="{x1:.1f}" y2="{y1:.1f}" stroke="{color}" stroke-width="2"/>'
        )
    height = float(high[1] - low[1]) * scale
    return f'<svg viewBox="0 0 {_WIDTH_PX} {height:.0f}">{"".join(drawn)}</svg><p class="soft">{told}</p>'
