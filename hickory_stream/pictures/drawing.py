"""Drawings of lines, ellipses and text, as SVG or as an image."""

from dataclasses import dataclass, field
from html import escape

import numpy as np
from numpy.typing import NDArray

Color = tuple[int, int, int]
_FONT_PX = 13
# OpenCV takes the fraction of a pixel in so many bits.
_SHIFT = 4


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Line:
    """A line through (N, 2) points; `dash_px` is the length of dashes and gaps, 0 for a solid line."""

    places_px: NDArray[np.float64]
    color: Color
    width_px: float = 1.5
    dash_px: float = 0.0


@dataclass(frozen=True, kw_only=True, slots=True)
class Ellipse:
    """An ellipse, filled or an outline; its first half axis is turned by `turn_deg` from x (right) to y (down)."""

    center_px: tuple[float, float]
    half_axes_px: tuple[float, float]
    color: Color
    turn_deg: float = 0.0
    is_filled: bool = True


@dataclass(frozen=True, kw_only=True, slots=True)
class Text:
    """One line of text; `place_px` is the left end, middle or right end of its baseline."""

    place_px: tuple[float, float]
    text: str
    color: Color
    anchor: str = "start"
    #: colour of a rim around the letters
    halo: Color | None = None


@dataclass(slots=True)
class Drawing:
    """A drawing; later parts cover earlier ones."""

    width: int
    height: int
    background: Color = (255, 255, 255)
    parts: list[Line | Ellipse | Text] = field(default_factory=list)

    def add(self, *parts: Line | Ellipse | Text) -> None:
        """Add parts."""
        self.parts.extend(parts)

    def svg(self) -> str:
        """Return the drawing as the text of an SVG."""
        lines = [
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {self.width} {self.height}" '
            f'width="{self.width}" height="{self.height}" font-family="sans-serif" font-size="{_FONT_PX}">',
            f'<rect width="{self.width}" height="{self.height}" fill="{_hex(self.background)}"/>',
            *(_svg_of(part) for part in self.parts),
            "</svg>",
            "",
        ]
        return "\n".join(lines)

    def image(self) -> NDArray[np.uint8]:
        """Return the drawing as an (H, W, 3) uint8 image, red first."""
        image = np.full((self.height, self.width, 3), self.background, dtype=np.uint8)
        for part in self.parts:
            match part:
                case Line():
                    _paint_line(image, part)
                case Ellipse():
                    _paint_ellipse(image, part)
                case Text():
                    _paint_text(image, part)
        return image


def _svg_of(part: Line | Ellipse | Text) -> str:
    color = _hex(part.color)
    match part:
        case Line():
            places = " ".join(f"{x:.1f},{y:.1f}" for x, y in part.places_px)
            dashes = f' stroke-dasharray="{part.dash_px:g}"' if part.dash_px else ""
            return (
                f'<polyline points="{places}" fill="none" stroke="{color}" stroke-width="{part.width_px:g}"{dashes}/>'
            )
        case Ellipse():
            (x, y), (a, b) = part.center_px, part.half_axes_px
            paint = f'fill="{color}"' if part.is_filled else f'fill="none" stroke="{color}"'
            turn = f' transform="rotate({part.turn_deg:.1f} {x:.1f} {y:.1f})"'
            return f'<ellipse cx="{x:.1f}" cy="{y:.1f}" rx="{a:.1f}" ry="{b:.1f}" {paint}{turn}/>'
        case Text():
            x, y = part.place_px
            rim = "" if part.halo is None else f' stroke="{_hex(part.halo)}" stroke-width="4" paint-order="stroke"'
            return (
                f'<text x="{x:.1f}" y="{y:.1f}" fill="{color}" text-anchor="{part.anchor}"{rim}>'
                f"{escape(part.text)}</text>"
            )


def _hex(color: Color) -> str:
    return "#" + "".join(f"{part:02x}" for part in color)


def _fixed(places_px: NDArray[np.float64]) -> NDArray[np.int32]:
    # Far outside of any picture OpenCV overflows.
    return np.round(np.clip(places_px, -1e5, 1e5) * (1 << _SHIFT)).astype(np.int32)


def _paint_line(image: NDArray[np.uint8], line: Line) -> None:
    import cv2

    pieces = _dashes(line.places_px, line.dash_px) if line.dash_px else [line.places_px]
    width = max(round(line.width_px), 1)
    cv2.polylines(image, [_fixed(piece) for piece in pieces], False, line.color, width, cv2.LINE_AA, _SHIFT)


def _dashes(places_px: NDArray[np.float64], dash_px: float) -> list[NDArray[np.float64]]:
    steps = np.linalg.norm(np.diff(places_px, axis=0), axis=1)
    marks = np.concatenate([[0.0], np.cumsum(steps)])
    starts = np.arange(0.0, marks[-1], 2 * dash_px)

    def at(way: float) -> NDArray[np.float64]:
        return np.array([np.interp(way, marks, places_px[:, axis]) for axis in range(2)])

    return [np.array([at(start), at(min(start + dash_px, marks[-1]))]) for start in starts]


def _paint_ellipse(image: NDArray[np.uint8], ellipse: Ellipse) -> None:
    import cv2

    center, half = (_fixed(np.array(pair)).tolist() for pair in (ellipse.center_px, ellipse.half_axes_px))
    thickness = cv2.FILLED if ellipse.is_filled else 1
    cv2.ellipse(
        image, center, half, ellipse.turn_deg, 0, 360, ellipse.color, thickness, lineType=cv2.LINE_AA, shift=_SHIFT
    )


def _paint_text(image: NDArray[np.uint8], text: Text) -> None:
    import cv2

    (width, _), _ = cv2.getTextSize(text.text, cv2.FONT_HERSHEY_SIMPLEX, _FONT_PX / 30, 1)
    x = text.place_px[0] - {"start": 0.0, "middle": width / 2, "end": float(width)}[text.anchor]
    place = (round(x), round(text.place_px[1]))
    for color, width in ((text.halo, 5), (text.color, 1)):
        if color is not None:
            cv2.putText(image, text.text, place, cv2.FONT_HERSHEY_SIMPLEX, _FONT_PX / 30, color, width, cv2.LINE_AA)
