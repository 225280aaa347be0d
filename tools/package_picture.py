"""Draws the packages and their imports from the code: `hickory_stream/packages.svg`, the picture in the README.

A box is a package, or the single modules of `hickory_stream` that stand on the same row. A line says that something in
the upper box imports something in the lower one; what also follows from other lines is left out (the transitive
reduction), so that the picture stays readable. The same code gives the same bytes.
"""

from __future__ import annotations

import argparse
import ast
import sys
from graphlib import TopologicalSorter
from html import escape
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PICTURE = ROOT / "hickory_stream" / "packages.svg"
ROOTS = ("hickory_stream", "players")

Graph = dict[str, set[str]]
Box = tuple[str, ...]
Lines = dict[Box, set[Box]]

_CHAR_PX, _BOX_PX, _ROW_PX, _GAP_PX, _MARGIN_PX, _BEND_PX = 7.6, 28, 58, 22, 16, 4


def import_graph(root: Path = ROOT) -> Graph:
    """Return for each package, or module that is in none, the others that it imports, type annotations included."""
    modules = {_module_of(file, root): file for name in ROOTS for file in sorted((root / name).rglob("*.py"))}
    graph: Graph = {}
    for module, file in modules.items():
        if module in ROOTS[:1]:
            continue  # it offers the API of all others, and imports them only when asked
        node = _node_of(module)
        graph.setdefault(node, set()).update(_node_of(name) for name in _imported(file, modules))
    return {node: {other for other in found if other in graph} - {node} for node, found in graph.items()}


def picture(graph: Graph) -> str:
    """Return the SVG of a graph; raises `graphlib.CycleError` where its imports go round in a circle."""
    ranks = _ranks(graph)
    boxes = _boxes(graph, ranks)
    row_of = {box: ranks[box[0]] for box in boxes}
    lines = _through_rows(_reduced(_between(graph, boxes)), row_of)
    rows = _ordered(
        [sorted(box for box in row_of if row_of[box] == row) for row in range(max(row_of.values()) + 1)], lines
    )
    full = max(sum(map(_width, row)) + _GAP_PX * (len(row) - 1) for row in rows)
    places: dict[Box, tuple[float, float]] = {}
    for rank, row in enumerate(rows):
        x = _MARGIN_PX + (full - sum(map(_width, row)) - _GAP_PX * (len(row) - 1)) / 2
        for box in row:
            places[box] = (x, _MARGIN_PX + (len(rows) - 1 - rank) * _ROW_PX)
            x += _width(box) + _GAP_PX
    return _svg(places, lines, full + 2 * _MARGIN_PX, 2 * _MARGIN_PX + (len(rows) - 1) * _ROW_PX + _BOX_PX)


# ---- the graph -------------------------------------------------------------------------------------------------------


def _module_of(file: Path, root: Path) -> str:
    return ".".join(file.relative_to(root).with_suffix("").parts).removesuffix(".__init__")


def _node_of(module: str) -> str:
    """Return the box of a module: `players`, the package in `hickory_stream`, or the module itself."""
    return module.split(".")[0] if not module.startswith("hickory_stream.") else module.split(".")[1]


def _imported(file: Path, modules: dict[str, Path]) -> set[str]:
    found = set()
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module is not None:
            full = (f"{node.module}.{alias.name}" for alias in node.names)
            found.update(name if name in modules else node.module for name in full)
        elif isinstance(node, ast.Import):
            found.update(alias.name for alias in node.names)
    return {name for name in found if name in modules and name not in ROOTS[:1]}


def _ranks(graph: Graph) -> dict[str, int]:
    """Return the row of each node: one above the highest that it imports. Raises `graphlib.CycleError`."""
    ranks: dict[str, int] = {}
    for node in TopologicalSorter(graph).static_order():
        ranks[node] = max((ranks[other] + 1 for other in graph[node]), default=0)
    return ranks


def _boxes(graph: Graph, ranks: dict[str, int]) -> list[Box]:
    """Return what stands in one box: a package alone, the single modules of a row together."""
    boxes: list[Box] = [(node,) for node in sorted(graph) if _is_package(node)]
    for rank in sorted(set(ranks.values())):
        single = tuple(node for node in sorted(graph) if ranks[node] == rank and not _is_package(node))
        boxes += [single] if single else []
    return boxes


def _is_package(node: str) -> bool:
    return node in ROOTS or (ROOT / "hickory_stream" / node / "__init__.py").is_file()


def _between(graph: Graph, boxes: list[Box]) -> Lines:
    box_of = {node: box for box in boxes for node in box}
    return {box: {box_of[other] for node in box for other in graph[node]} - {box} for box in boxes}


def _reduced(lines: Lines) -> Lines:
    """Return the lines that do not follow from others."""
    below: Lines = {}
    for box in TopologicalSorter(lines).static_order():
        below[box] = set().union(*({other} | below[other] for other in lines[box]))
    return {
        box: {other for other in others if not any(other in below[between] for between in others)}
        for box, others in lines.items()
    }


# ---- the drawing (Sugiyama, Tagawa and Toda 1981) --------------------------------------------------------------------


def _through_rows(lines: Lines, row_of: dict[Box, int]) -> Lines:
    """Return the lines with a bend, a box without a name, in each row that one passes; the bends join `row_of`."""
    routed: Lines = {box: set() for box in lines}
    for box, others in sorted(lines.items()):
        for other in sorted(others):
            last = box
            for row in range(row_of[box] - 1, row_of[other], -1):
                bend = ("", *box, "", *other, str(row))
                row_of[bend] = row
                routed[last].add(bend)
                routed[bend] = set()
                last = bend
            routed[last].add(other)
    return routed


def _ordered(rows: list[list[Box]], lines: Lines) -> list[list[Box]]:
    """Return the rows, each sorted by the mean place of its neighbours, swept up and down a few times."""
    near: Lines = {box: set(others) for box, others in lines.items()}
    for box, others in lines.items():
        for other in others:
            near[other].add(box)
    place = {box: (i + 0.5) / len(row) for row in rows for i, box in enumerate(row)}
    for sweep in range(12):
        for row in rows if sweep % 2 else reversed(rows):
            mean = {box: sum(sorted(place[other] for other in near[box])) / max(len(near[box]), 1) for box in row}
            row.sort(key=lambda box, mean=mean: (round(mean[box], 9), box))  # type: ignore[misc]
            place.update({box: (i + 0.5) / len(row) for i, box in enumerate(row)})
    return rows


def _is_bend(box: Box) -> bool:
    return box[0] == ""


def _width(box: Box) -> float:
    return _BEND_PX if _is_bend(box) else round(_CHAR_PX * len(_label(box)) + 20, 1)


def _label(box: Box) -> str:
    return ", ".join(box)


def _svg(places: dict[Box, tuple[float, float]], lines: Lines, width: float, height: float) -> str:
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:.0f} {height:.0f}" width="{width:.0f}" '
        f'height="{height:.0f}" font-family="DejaVu Sans Mono, monospace" font-size="12.5">',
        f'<rect width="{width:.0f}" height="{height:.0f}" fill="#ffffff"/>',
    ]
    for box, (x, y) in sorted(places.items()):
        start_x, middle = x + _width(box) / 2, y + _BOX_PX / 2
        if _is_bend(box):
            parts.append(_path(f"M{start_x:.1f} {y} V{y + _BOX_PX}"))
        for other in sorted(lines[box]):
            end_x, end_y = places[other][0] + _width(other) / 2, places[other][1]
            bend_y = (y + _BOX_PX + end_y) / 2
            parts.append(
                _path(
                    f"M{start_x:.1f} {y + _BOX_PX} C{start_x:.1f} {bend_y:.1f} {end_x:.1f} {bend_y:.1f} "
                    f"{end_x:.1f} {end_y}"
                )
            )
        if not _is_bend(box):
            fill = "#cfe0f5" if len(box) == 1 and _is_package(box[0]) else "#eef2f8"
            parts.append(
                f'<rect x="{x:.1f}" y="{y}" width="{_width(box)}" height="{_BOX_PX}" rx="5" fill="{fill}" '
                f'stroke="#4a5b75"/><text x="{start_x:.1f}" y="{middle + 4.5}" text-anchor="middle" '
                f'fill="#1c2430">{escape(_label(box))}</text>'
            )
    return "\n".join([*parts, "</svg>", ""])


def _path(steps: str) -> str:
    return f'<path d="{steps}" fill="none" stroke="#8a94a6"/>'


def main() -> int:
    """Write the picture, or with `--check` say whether it is that of the code."""
    parser = argparse.ArgumentParser(prog="tools/draw_packages", description=__doc__.splitlines()[0])
    parser.add_argument("--check", action="store_true", help="exit with 1 where the picture is not that of the code")
    arguments = parser.parse_args()
    drawn = picture(import_graph())
    if arguments.check:
        is_current = PICTURE.is_file() and PICTURE.read_text(encoding="utf-8") == drawn
        if not is_current:
            print(f"{PICTURE.relative_to(ROOT)} is not that of the code: run tools/draw_packages", file=sys.stderr)
        return int(not is_current)
    PICTURE.write_text(drawn, encoding="utf-8")
    print(PICTURE.relative_to(ROOT))
    return 0


if __name__ == "__main__":
    sys.exit(main())
