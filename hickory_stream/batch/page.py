"""The table of a batch, as text and as one HTML page."""

import html
from collections.abc import Sequence
from pathlib import Path

from hickory_stream.base.atomic_files import write_output
from hickory_stream.base.html_page import page
from hickory_stream.base.terminal import visible
from hickory_stream.batch.result import BatchResult, Joined, Overlap, Row

_STYLE = """
table { background: var(--card); border: 1px solid var(--line); width: 100%; }
th, td { padding: .3rem .8rem; text-align: left; border-bottom: 1px solid var(--line); }
td.n, th.n { text-align: right; }
tr.bad td:first-child { border-left: 5px solid var(--bad); }
tr.good td:first-child { border-left: 5px solid var(--good); }
"""
_HEAD = ("log", "state", "objects", "keyframes", "wall s", "processor s", "MB", "digest", "made by")
_NUMBERS = range(2, 7)
_DIGITS = 12


def table_of(result: BatchResult) -> list[tuple[str, ...]]:
    """Return the cells of the table, column names first."""
    return [_HEAD, *(_cells(row) for row in result.rows)]


def text_of(result: BatchResult) -> str:
    """Return the table and the overlaps as text."""
    rows = table_of(result)
    widths = [max(len(row[i]) for row in rows) for i in range(len(_HEAD))]
    lines = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]
    lines += [f"{row.name}: {row.reason}" for row in result.rows if row.reason]
    if result.joined is not None:
        lines += _joined_lines(result.joined)
    return "\n".join(visible(line) for line in lines)


def write_page(path: Path, result: BatchResult) -> None:
    """Write the page; raises `OSError` when the disk refused."""
    rows = "".join(_html_row(row) for row in result.rows)
    mapped = sum(row.state == "mapped" for row in result.rows)
    parts = [
        f"<h1>{mapped} of {len(result.rows)} logs mapped</h1>",
        f"<p class=soft>{html.escape(str(result.out))}, {result.wall_s:.0f} s in this run</p>",
        f"<p><b>{html.escape(result.stopped)}</b></p>" if result.stopped else "",
        f"<h2>Logs</h2><table><tr>{_cells_html(_HEAD, 'th')}</tr>{rows}</table>",
    ]
    if result.joined is not None:
        parts.append(_overlaps_html(result.joined))
    write_output(path, page("Batch", "".join(parts), _STYLE).encode())


def _cells(one: Row) -> tuple[str, ...]:
    if one.state != "mapped":
        return (one.name, one.state, "", "", "", "", "", "", one.worker)
    state = "mapped before" if one.was_there else "gone on with" if one.resumed else "mapped"
    numbers = (str(one.objects), str(one.keyframes), f"{one.wall_s:.0f}", f"{one.cpu_s:.0f}", f"{one.map_mb:.0f}")
    return (one.name, state, *numbers, (one.digest or "")[:_DIGITS], one.worker)


def _joined_lines(joined: Joined) -> list[str]:
    believed = sum(overlap.is_believed for overlap in joined.overlaps)
    lines = [
        f"overlaps: {len(joined.overlaps)} of {joined.num_pairs} pairs of maps align"
        + (f", of which {len(joined.overlaps) - believed} contradict others" if believed < len(joined.overlaps) else "")
    ]
    lines += [
        f"{one.path}: {one.num_objects} objects of {', '.join(one.names)}, {one.num_united} of them in several maps"
        for one in joined.merged
    ]
    return lines + [f"left out: {problem}" for problem in joined.problems]


def _html_row(row: Row) -> str:
    kind = "good" if row.state == "mapped" else "bad"
    reason = row.reason
    cells = list(_cells(row))
    text = f"<tr class={kind}>{_cells_html(cells)}</tr>"
    return text + (f"<tr class={kind}><td colspan={len(cells)}>{html.escape(reason)}</td></tr>" if reason else "")


def _cells_html(cells: Sequence[str], kind: str = "td") -> str:
    return "".join(
        f"<{kind}{' class=n' if i in _NUMBERS else ''}>{html.escape(cell)}</{kind}>" for i, cell in enumerate(cells)
    )


def _overlaps_html(joined: Joined) -> str:
    lines = "".join(f"<p>{html.escape(line)}</p>" for line in _joined_lines(joined))
    rows = "".join(
        f"<tr class={'good' if one.is_believed else 'bad'}>"
        f"<td>{html.escape(one.a)}</td><td>{html.escape(one.b)}</td><td class=n>{one.num_pairs or ''}</td>"
        f"<td>{html.escape(_said(one))}</td>"
        "</tr>"
        for one in joined.overlaps
    )
    head = "<tr><th>map</th><th>map</th><th class=n>objects that agree</th><th></th></tr>"
    return f"<h2>Overlaps</h2>{lines}<table>{head}{rows}</table>"


def _said(one: Overlap) -> str:
    if one.is_believed:
        return "believed"
    return "contradicted by others" if one.num_pairs else one.told
