"""The table of a batch, as text and as one HTML page without network access."""

from __future__ import annotations

import html
from typing import TYPE_CHECKING

from hickory_stream.engine.atomic import write_output
from hickory_stream.terminal import visible

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from hickory_stream.batch.result import BatchResult, Joined, Overlap, Row

_STYLE = """
:root { color-scheme: light dark; --ink: #1d2330; --soft: #667; --line: #d5d9e2; --card: #fff; --back: #f3f4f7; }
@media (prefers-color-scheme: dark) {
  :root { --ink: #e7e9ee; --soft: #9aa3b5; --line: #343b4a; --card: #1e232e; --back: #14171e; }
}
body { font: 15px/1.45 system-ui, sans-serif; color: var(--ink); background: var(--back); margin: 2rem auto;
  max-width: 1180px; padding: 0 1rem; }
h1 { font-size: 1.5rem; margin: 0 0 .2rem; } h2 { font-size: 1.15rem; margin: 2rem 0 .6rem; }
p.soft { color: var(--soft); margin: .2rem 0; }
table { border-collapse: collapse; background: var(--card); border: 1px solid var(--line); width: 100%; }
th, td { padding: .3rem .8rem; text-align: left; border-bottom: 1px solid var(--line); }
th { font-weight: 600; color: var(--soft); }
td.n { font-variant-numeric: tabular-nums; text-align: right; white-space: nowrap; }
tr.bad td:first-child { border-left: 5px solid #c8452f; } tr.good td:first-child { border-left: 5px solid #4b9a5b; }
code { font-size: .85em; }
"""
_HEAD = ("log", "state", "objects", "keyframes", "wall s", "processor s", "MB", "digest", "made by")
_DIGITS = 12


def table_of(result: BatchResult) -> list[tuple[str, ...]]:
    """Return the cells of the table, the names of the columns first."""
    return [_HEAD, *(_cells(row) for row in result.rows)]


def text_of(result: BatchResult) -> str:
    """Return the table and what is said of overlaps, for people."""
    rows = table_of(result)
    widths = [max(len(row[i]) for row in rows) for i in range(len(_HEAD))]
    lines = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]
    lines += [f"{row.outcome.name}: {row.outcome.reason}" for row in result.rows if row.outcome.reason]
    if result.joined is not None:
        lines += _joined_lines(result.joined)
    return "\n".join(visible(line) for line in lines)


def write_page(path: Path, result: BatchResult) -> None:
    """Write the page.

    Raises:
        OSError: the disk refused.
    """
    rows = "".join(_html_row(row) for row in result.rows)
    mapped = sum(row.outcome.state == "mapped" for row in result.rows)
    parts = [
        f"<h1>{mapped} of {len(result.rows)} logs mapped</h1>",
        f"<p class=soft>{_escaped(str(result.out))}, {result.wall_s:.0f} s in this run</p>",
        f"<p><b>{_escaped(result.stopped)}</b></p>" if result.stopped else "",
        f"<h2>Logs</h2><table><tr>{_cells_html(_HEAD, 'th')}</tr>{rows}</table>",
    ]
    if result.joined is not None:
        parts.append(_overlaps_html(result.joined))
    page = (
        "<!doctype html><html lang=en><meta charset=utf-8><title>Batch</title>"
        f"<style>{_STYLE}</style><body>{''.join(parts)}</body></html>\n"
    )
    write_output(path, page.encode())


def _cells(row: Row) -> tuple[str, ...]:
    one = row.outcome
    if one.state != "mapped":
        return (one.name, one.state, "", "", "", "", "", "", one.worker)
    state = "mapped before" if row.was_there else "gone on with" if one.resumed else "mapped"
    numbers = (str(one.objects), str(one.keyframes), f"{one.wall_s:.0f}", f"{one.cpu_s:.0f}", f"{one.map_mb:.0f}")
    return (one.name, state, *numbers, (one.digest or "")[:_DIGITS], one.worker)


def _joined_lines(joined: Joined) -> list[str]:
    believed = sum(overlap.is_believed for overlap in joined.overlaps)
    lines = [
        f"overlaps: {len(joined.overlaps)} of {joined.num_pairs} pairs aligned, {believed} believed; "
        f"{joined.signature_kb:.0f} kB a place signature"
    ]
    lines += [
        f"{one.path}: {one.num_objects} objects of {', '.join(one.names)}, {one.num_united} of them in several maps"
        for one in joined.merged
    ]
    return lines + [f"left out: {problem}" for problem in joined.problems]


def _html_row(row: Row) -> str:
    kind = "good" if row.outcome.state == "mapped" else "bad"
    reason = row.outcome.reason
    cells = list(_cells(row))
    told = f"<tr class={kind}>{_cells_html(cells)}</tr>"
    return told + (f"<tr class={kind}><td colspan={len(cells)}>{_escaped(reason)}</td></tr>" if reason else "")


def _cells_html(cells: Sequence[str], kind: str = "td") -> str:
    numbers = range(2, 7) if kind == "td" else ()
    return "".join(
        f"<{kind}{' class=n' if i in numbers else ''}>{_escaped(cell)}</{kind}>" for i, cell in enumerate(cells)
    )


def _overlaps_html(joined: Joined) -> str:
    lines = "".join(f"<p>{_escaped(line)}</p>" for line in _joined_lines(joined))
    rows = "".join(
        f"<tr class={'good' if one.is_believed else 'bad'}>"
        f"<td>{_escaped(one.a)}</td><td>{_escaped(one.b)}</td><td class=n>{one.num_pairs or ''}</td>"
        f"<td>{_escaped(_said(one))}</td>"
        "</tr>"
        for one in joined.overlaps
    )
    head = "<tr><th>map</th><th>map</th><th>objects that agree</th><th></th></tr>"
    return f"<h2>Overlaps</h2>{lines}<table>{head}{rows}</table>"


def _said(one: Overlap) -> str:
    if one.is_believed:
        return "believed"
    return "contradicted by others" if one.num_pairs else one.told


def _escaped(text: str) -> str:
    return html.escape(visible(text))
