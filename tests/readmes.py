"""Code blocks, prose and tables of a README."""

import re

_TABLE = re.compile(r"^(?P<rows>(?:\|.*\n)+)\n*(?P<after>.*)", re.MULTILINE)
_MARK = re.compile(r"\*Typed figures.*\b[0-9a-f]{7}, \d{4}-\d\d-\d\d: older than the code")
_NO_FIGURE = re.compile(r"`[^`]*`|\b(19|20)\d\d\b")


def blocks_of(language, readme):
    """Return the code blocks of one language in a README, joined."""
    text = readme.read_text(encoding="utf-8")
    return "".join(re.findall(rf"^```{language}\n(.*?)^```", text, flags=re.MULTILINE | re.DOTALL))


def prose_of(readme):
    """Return the lines outside code blocks and tables, each with its number from 1."""
    prose, is_code = [], False
    for number, line in enumerate(readme.read_text(encoding="utf-8").splitlines(), start=1):
        if line.startswith("```"):
            is_code = not is_code
        elif not is_code and not line.startswith("|"):
            prose.append((number, line))
    return prose


def unmarked_tables(text):
    """Return the first rows of the tables of figures that are neither generated nor marked as typed."""
    # A table of figures has a number in most cells beside its first column; years are no figures. Below a typed one
    # stands a line such as `*Typed figures of commit d752b20, 2026-11-22: older than the code.*`.
    rest = re.sub("<!-- figures: .*?\n.*?<!-- end of figures -->", "", text, flags=re.DOTALL)
    found = []
    for table in _TABLE.finditer(rest):
        header, _, *rows = table["rows"].splitlines()
        cells = [_NO_FIGURE.sub("", cell) for row in rows for cell in cells_of(row)[1:]]
        num_figures = sum(bool(re.search(r"\d", cell)) for cell in cells)
        is_of_figures = num_figures >= 4 and num_figures >= 0.5 * len([*filter(None, cells)])
        if any(cells_of(header)) and is_of_figures and not _MARK.match(table["after"]):
            found.append(rows[0])
    return found


def cells_of(line):
    return [cell.strip() for cell in line.strip().strip("|").split("|")]
