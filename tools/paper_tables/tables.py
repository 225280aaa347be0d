"""A table of figures with the paper's own beside them: as Markdown, CSV and JSON."""
# A table as a figure: for every column a group of bars, ours dark with its interval, the paper's light below it.

import csv
import io
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from itertools import islice
from typing import Any

import numpy as np

from hickory_stream.pictures.drawing import Drawing, Line, Text


@dataclass(frozen=True, kw_only=True, slots=True)
class Cell:
    """A measured figure: `low` and `high` are its 95 % interval, `num` of how many it is the mean or the share."""

    # `value` None: not measured, for the reason `why`. `paper` is what the paper has there, None where it has nothing.
    value: float | None
    paper: float | None = None
    low: float | None = None
    high: float | None = None
    num: int | None = None
    why: str = ""


@dataclass(frozen=True, kw_only=True, slots=True)
class Column:
    """A column: `digits` behind the point; `more` is +1 where more is better, -1 where less is, 0 for neither."""

    name: str
    title: str
    unit: str = ""
    digits: int = 3
    more: int = 0


@dataclass(frozen=True, kw_only=True, slots=True)
class Table:
    """A table; every row has a title and a cell for each column. `notes` are printed below it."""

    # `groups` are how many rows each are to be compared with one another, e.g. those of one scene; (): all of them.
    name: str
    caption: str
    columns: tuple[Column, ...]
    rows: tuple[tuple[str, tuple[Cell, ...]], ...]
    notes: tuple[str, ...] = ()
    groups: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        if self.groups and sum(self.groups) != len(self.rows):
            raise ValueError(f"groups of {sum(self.groups)} rows in a table of {len(self.rows)}")
        for title, cells in self.rows:
            if len(cells) != len(self.columns):
                raise ValueError(f"row {title!r} has {len(cells)} cells for {len(self.columns)} columns")


def markdown(table: Table) -> str:
    """Return the table for people; of rows to be compared the best is bold, the paper's figure is behind a slash."""
    heads = [f"{c.title}{f', {c.unit}' if c.unit else ''}{_ARROWS[c.more]}" for c in table.columns]
    lines = [f"**{table.caption}**", "", "| | " + " | ".join(heads) + " |", "|---" * (1 + len(heads)) + "|"]
    rows = iter(table.rows)
    for size in table.groups or (len(table.rows),):
        group = list(islice(rows, size))
        best = [_best(column, [cells[i].value for _, cells in group]) for i, column in enumerate(table.columns)]
        for title, cells in group:
            shown = [
                _shown(cell, column, is_best=_is_shown_as(cell.value, top, column.digits))
                for cell, column, top in zip(cells, table.columns, best, strict=True)
            ]
            lines.append(f"| {title} | " + " | ".join(shown) + " |")
    lines += ["", "*Ours [95 % interval] (of how many) / the paper's own.*"]
    return "\n".join([*lines, *(f"*{note}*" for note in table.notes), ""])


def as_csv(table: Table) -> str:
    text = io.StringIO()
    names = ("table", "row", "column", "unit", "value", "low", "high", "num", "paper", "why")
    writer = csv.DictWriter(text, names, lineterminator="\n")
    writer.writeheader()
    writer.writerows({"table": table.name, **row} for row in as_json(table)["rows"])
    return text.getvalue()


def as_json(table: Table) -> dict[str, Any]:
    return {
        "table": table.name,
        "caption": table.caption,
        "notes": list(table.notes),
        "rows": [
            {"row": title, "column": column.name, "unit": column.unit, **asdict(cell)}
            for title, cells in table.rows
            for cell, column in zip(cells, table.columns, strict=True)
        ],
    }


_ARROWS = {1: " ↑", 0: "", -1: " ↓"}


def _best(column: Column, values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    if not column.more or len(known) < 2 or min(known) == max(known):
        return None
    return max(known) if column.more > 0 else min(known)


def _is_shown_as(value: float | None, top: float | None, digits: int) -> bool:
    return value is not None and top is not None and f"{value:.{digits}f}" == f"{top:.{digits}f}"


def _shown(cell: Cell, column: Column, *, is_best: bool) -> str:
    paper = "" if cell.paper is None else f" / {cell.paper:.{column.digits}f}"
    if cell.value is None:
        return (cell.why or "-") + paper
    value = f"{cell.value:.{column.digits}f}"
    text = f"**{value}**" if is_best else value
    if cell.low is not None and cell.high is not None:
        text += f" [{cell.low:.{column.digits}f}, {cell.high:.{column.digits}f}]"
    return text + ("" if cell.num is None else f" ({cell.num})") + paper


def mean_of(values: Sequence[float]) -> float | None:
    return sum(values) / len(values) if values else None


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
