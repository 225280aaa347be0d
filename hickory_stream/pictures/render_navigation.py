"""A picture of a plan: the grid from above, layer 4 of the objects in their colours, the path and the body along it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry.display import color_of_id
from hickory_stream.geometry.superquadric_surface import display_mesh
from hickory_stream.navigation.free_space import FreeSpace, layer_four_of, obstacles_of
from hickory_stream.navigation.occupancy import Cell
from hickory_stream.navigation.robot import Posture
from hickory_stream.navigation.search import NoPath, Path
from hickory_stream.pictures.labels import Label, draw_labels, draw_scale, draw_title, flat_labels
from hickory_stream.pictures.legend import legend_of
from hickory_stream.records import MapSnapshot

_TITLE_PX, _MARGIN_PX, _LONG_SIDE_PX = 44, 30, 1000
_FREE, _OCCUPIED, _UNKNOWN, _WALL = (250, 250, 248), (148, 154, 166), (208, 210, 216), (44, 48, 58)
_LOW = (222, 235, 247)
_PATH, _DUCKED, _START, _GOAL = (28, 98, 196), (206, 52, 110), (24, 140, 84), (206, 66, 40)
_BODY_STEP_M = 0.35


def render_plan(
    snapshot: MapSnapshot,
    space: FreeSpace,
    answer: Path | NoPath,
    start: NDArray[np.float64],
    goal: NDArray[np.float64],
) -> NDArray[np.uint8]:
    """Return an (H, W, 3) uint8 picture of a plan, or of the scene without one; pale blue: lowered postures only."""
    canvas = _Canvas.of(space)
    _draw_walls(canvas, space)
    labels = _draw_objects(canvas, snapshot)
    if isinstance(answer, Path):
        _draw_path(canvas, space, answer)
    draw_labels(canvas.image, labels)
    for name, place, color in (("start", start, _START), ("goal", goal, _GOAL)):
        _draw_end(canvas, name, place, color)
    picture = canvas.framed()
    draw_scale(picture[_TITLE_PX:], canvas.pixels_per_m)
    draw_title(picture[:_TITLE_PX], _title(space, answer))
    legend = legend_of(_meanings(space, answer), picture.shape[1])
    return np.concatenate([picture, legend, picture[-_MARGIN_PX // 3 :, :1].repeat(picture.shape[1], axis=1)])


def _meanings(space: FreeSpace, answer: Path | NoPath) -> list[tuple[str, tuple[int, int, int]]]:
    postures = [posture.name for posture in space.robot.postures]
    entries = [(f"free for {space.robot.name}", _FREE)]
    entries += [(f"free if {' or '.join(postures[1:])}", _LOW)] if len(postures) > 1 else []
    entries += [("too near to an object or wall", _OCCUPIED), ("not observed", _UNKNOWN), ("wall", _WALL)]
    if isinstance(answer, Path):
        used = {int(posture) > 0 for posture in answer.postures}
        entries += [("path, with the body along it", _PATH)] if False in used else []
        entries += [("path in a lowered posture", _DUCKED)] if True in used else []
    return [*entries, ("with numbers: layer 4 of objects", (170, 200, 170))]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Canvas:
    """A picture with y downwards, and the transform of places in the world to its pixels."""

    image: NDArray[np.uint8]
    space: FreeSpace
    pixels_per_m: float

    @classmethod
    def of(cls, space: FreeSpace) -> "_Canvas":
        import cv2

        frame = space.frame
        scale = max(round(_LONG_SIDE_PX / max(frame.shape)), 1)
        small = _colored(space)
        image = cv2.resize(small[::-1], None, fx=scale, fy=scale, interpolation=cv2.INTER_NEAREST)
        return cls(image=np.ascontiguousarray(image), space=space, pixels_per_m=scale / frame.cell_m)

    def pixels(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the (N, 2) pixels of (N, 2) places in the world."""
        scaled = (np.asarray(points) - self.space.frame.origin_m) * self.pixels_per_m
        return np.stack([scaled[:, 0], self.image.shape[0] - scaled[:, 1]], axis=1)

    def fixed(self, points: NDArray[np.float64]) -> NDArray[np.int32]:
        """Return pixels in the fixed-point format of cv2, with 4 fractional bits."""
        return np.asarray(np.round(16 * self.pixels(points)), dtype=np.int32)

    def framed(self) -> NDArray[np.uint8]:
        height, width = self.image.shape[:2]
        side = max(_MARGIN_PX, (760 - width) // 2)
        out = np.full((height + _TITLE_PX + 2 * _MARGIN_PX, width + 2 * side, 3), 255, np.uint8)
        top = _TITLE_PX + _MARGIN_PX
        out[top : top + height, side : side + width] = self.image
        return out


def _colored(space: FreeSpace) -> NDArray[np.uint8]:
    """Return the colours (rows, columns, 3): a free cell has that of the first posture in which any heading is free."""
    states = np.stack([np.stack([layer.states() for layer in headings]) for headings in space.layers])
    is_free = (states == Cell.FREE).any(axis=1)
    image = np.full((*space.frame.shape, 3), _OCCUPIED, np.uint8)
    image[(states == Cell.UNKNOWN).any(axis=(0, 1))] = _UNKNOWN
    image[is_free.any(axis=0)] = _LOW
    image[is_free[0]] = _FREE
    return image


def _draw_walls(canvas: _Canvas, space: FreeSpace) -> None:
    import cv2

    for hull in space.walls:
        corners = cv2.convexHull(np.ascontiguousarray(hull[:, :2], dtype=np.float32))[:, 0]
        cv2.fillPoly(canvas.image, [canvas.fixed(corners)], _WALL, cv2.LINE_8, shift=4)


def _draw_objects(canvas: _Canvas, snapshot: MapSnapshot) -> list[Label]:
    """Draw layer 4 of the objects, and return the labels to draw over the path."""
    import cv2

    tinted = canvas.image.copy()
    outlines: dict[int, list[NDArray[np.float64]]] = {}
    for tracked in obstacles_of(snapshot):
        parts = [display_mesh(layer_four_of(tracked), i)[0] for i in range(len(layer_four_of(tracked)))]
        hulls = [cv2.convexHull(np.ascontiguousarray(vertices[:, :2]))[:, 0] for vertices in parts]
        outlines[tracked.id] = [canvas.pixels(hull) for hull in hulls]
    fixed = [(np.round(16 * hull).astype(np.int32), color_of_id(i)) for i, hulls in outlines.items() for hull in hulls]
    for corners, color in fixed:
        cv2.fillPoly(tinted, [corners], color, cv2.LINE_AA, shift=4)
    cv2.addWeighted(tinted, 0.38, canvas.image, 0.62, 0.0, dst=canvas.image)
    for corners, color in fixed:
        dark = tuple(round(0.62 * c) for c in color)
        cv2.polylines(canvas.image, [corners], isClosed=True, color=dark, thickness=1, lineType=cv2.LINE_AA, shift=4)
    return flat_labels({i: hulls for i, hulls in outlines.items() if hulls}, canvas.image.shape[1::-1])


def _draw_path(canvas: _Canvas, space: FreeSpace, path: Path) -> None:
    import cv2

    bodies = canvas.image.copy()
    for place, heading, posture in _places_along(path):
        color = _PATH if posture == 0 else _DUCKED
        for outline in _footprints(space.robot.postures[posture], place, heading):
            cv2.fillPoly(bodies, [canvas.fixed(outline)], color, cv2.LINE_AA, shift=4)
    cv2.addWeighted(bodies, 0.16, canvas.image, 0.84, 0.0, dst=canvas.image)
    for i in range(len(path.points) - 1):
        a, b = canvas.fixed(path.points[i : i + 2])
        color = _PATH if path.postures[i] == 0 else _DUCKED
        cv2.line(canvas.image, a.tolist(), b.tolist(), color, 3, cv2.LINE_AA, shift=4)
    for x, y in canvas.fixed(path.points[1:-1]).tolist():
        cv2.circle(canvas.image, (x, y), 16 * 3, (255, 255, 255), cv2.FILLED, cv2.LINE_AA, shift=4)


def _places_along(path: Path) -> list[tuple[NDArray[np.float64], float, int]]:
    places = []
    for i, (a, b) in enumerate(zip(path.points[:-1], path.points[1:], strict=True)):
        count = max(int(np.linalg.norm(b - a) / _BODY_STEP_M), 1)
        shares = np.arange(count + (i == len(path.points) - 2)) / count
        places += [(a + share * (b - a), float(path.headings_rad[i]), int(path.postures[i])) for share in shares]
    return places


def _footprints(posture: Posture, place: NDArray[np.float64], heading_rad: float) -> list[NDArray[np.float64]]:
    import cv2

    c, s = np.cos(heading_rad), np.sin(heading_rad)
    angles = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    circle = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    outlines = []
    for part in posture.parts:
        corners = part.corners_m @ np.array([[c, s], [-s, c]]) + place
        around = corners[:, None] + (part.disc_m + part.ball_m) * circle
        outlines.append(cv2.convexHull(around.reshape(-1, 2).astype(np.float32))[:, 0].astype(np.float64))
    return outlines


def _draw_end(canvas: _Canvas, name: str, place: NDArray[np.float64], color: tuple[int, int, int]) -> None:
    import cv2

    ((x, y),) = np.round(canvas.pixels(np.asarray(place)[None])).astype(int).tolist()
    cv2.circle(canvas.image, (x, y), 9, (255, 255, 255), cv2.FILLED, cv2.LINE_AA)
    cv2.circle(canvas.image, (x, y), 7, color, cv2.FILLED, cv2.LINE_AA)
    (width, height), _ = cv2.getTextSize(name, cv2.FONT_HERSHEY_SIMPLEX, 0.5, 1)
    left = int(np.clip(x + 12, 2, canvas.image.shape[1] - width - 6))
    top = int(np.clip(y - 6 - height, 2, canvas.image.shape[0] - height - 8))
    cv2.rectangle(canvas.image, (left - 3, top - 3), (left + width + 3, top + height + 5), color, cv2.FILLED)
    cv2.putText(
        canvas.image, name, (left, top + height), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (255, 255, 255), 1, cv2.LINE_AA
    )


def _title(space: FreeSpace, answer: Path | NoPath) -> str:
    robot = space.robot
    if not isinstance(answer, Path):
        return f"{robot.name}    no path: {answer.reason.value}"
    lowered = sorted({robot.postures[int(p)].name for p in answer.postures if p > 0})
    text = f"{robot.name}    {answer.length_m:.2f} m in {len(answer.points) - 1} legs"
    return text + (f"    {', '.join(lowered)} on the red part" if lowered else "")
