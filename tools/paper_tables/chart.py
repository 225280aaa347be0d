"""A table as a figure: for every column a group of bars, ours dark with its interval, the paper's light below it."""

import numpy as np

from hickory_stream.pictures.drawing import Drawing, Line, Text
from tools.paper_tables.tables import Cell, Column, Table

_OURS, _PAPER, _INK, _SOFT, _RULE = (28, 98, 196), (198, 205, 217), (29, 35, 48), (102, 102, 119), (225, 228, 234)
_LETTER, _BAR, _PANEL, _GAP, _ROW, _TOP = 8, 150, 320, 20, 34, 86


def chart(table: Table) -> Drawing:
    """Return the figure; a column without figures is left out."""
    shown = [
        (column, [cells[i] for _, cells in table.rows])
        for i, column in enumerate(table.columns)
        if any(cells[i].value is not None or cells[i].paper is not None for _, cells in table.rows)
    ]
    left = 30 + _LETTER * max((len(title) for title, _ in table.rows), default=0)
    width = left + max(len(shown), 1) * (_PANEL + _GAP)
    drawing = Drawing(width, _TOP + _ROW * len(table.rows) + 24)
    drawing.add(Text(place_px=(16, 24), text=table.caption, color=_INK))
    drawing.add(
        Line(places_px=np.array([[16, 44], [40, 44]]), color=_OURS, width_px=9),
        Text(place_px=(46, 48), text="ours, with its 95 % interval", color=_SOFT),
        Line(places_px=np.array([[250, 44], [274, 44]]), color=_PAPER, width_px=9),
        Text(place_px=(280, 48), text="the paper's own", color=_SOFT),
    )
    for i, (title, _) in enumerate(table.rows):
        drawing.add(Text(place_px=(left - 12, _TOP + _ROW * i + 20), text=title, color=_INK, anchor="end"))
    for j, (column, cells) in enumerate(shown):
        _panel(drawing, left + j * (_PANEL + _GAP), column, cells)
    return drawing


def _panel(drawing: Drawing, left: float, column: Column, cells: list[Cell]) -> None:
    unit = f", {column.unit}" if column.unit else ""
    drawing.add(Text(place_px=(left, _TOP - 8), text=f"{column.title}{unit}", color=_INK))
    figures = [x for cell in cells for x in (cell.value, cell.paper, cell.high) if x is not None]
    largest = max([*figures, 1e-12])
    drawing.add(Line(places_px=np.array([[left, _TOP], [left, _TOP + _ROW * len(cells)]]), color=_RULE, width_px=1))
    for i, cell in enumerate(cells):
        y = _TOP + _ROW * i
        _bar(drawing, left, y + 10, cell.value, largest, (_OURS, column.digits))
        _bar(drawing, left, y + 24, cell.paper, largest, (_PAPER, column.digits))
        if cell.value is not None and cell.low is not None and cell.high is not None:
            ends = [left + _BAR * max(x, 0.0) / largest for x in (cell.low, cell.high)]
            drawing.add(Line(places_px=np.array([[ends[0], y + 10], [ends[1], y + 10]]), color=_INK, width_px=1.5))
        if cell.value is None and cell.why:
            drawing.add(Text(place_px=(left + 4, y + 15), text=cell.why, color=_SOFT))


def _bar(
    drawing: Drawing, left: float, y: float, value: float | None, largest: float, look: tuple[tuple[int, int, int], int]
) -> None:
    if value is None:
        return
    color, digits = look
    end = left + _BAR * max(value, 0.0) / largest
    drawing.add(Line(places_px=np.array([[left, y], [end, y]]), color=color, width_px=9))
    drawing.add(Text(place_px=(left + _BAR + 10, y + 4), text=f"{value:.{digits}f}", color=_SOFT))
