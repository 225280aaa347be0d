"""Rows of a damaged SQLite file, page by page, by the file format documented on sqlite.org.

Leaf pages describe their own rows, so the B-tree above them is not needed. Column types identify the table.
A row whose overflow pages form no chain of the right length has no values.
"""

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

_TABLE_LEAF = 0x0D
_MAX_ROW_BYTES = 1 << 30


@dataclass(frozen=True, slots=True)
class Row:
    """A row of a leaf page; `values()` reads it, overflow pages included."""

    pages: "PageFile"
    rowid: int
    offset: int
    payload_bytes: int

    def values(self) -> list[Any] | None:
        """Return the columns, or None where a page of the row is damaged."""
        return self.pages.read(self)


class PageFile:
    """A SQLite file as a sequence of pages."""

    def __init__(self, path: Path) -> None:
        self._path = path
        with path.open("rb") as stream:
            head = stream.read(100)
        page_bytes = int.from_bytes(head[16:18], "big")
        # The header may be damaged; 4096 is the default of every version of SQLite since 2016.
        is_valid = page_bytes == 1 or (page_bytes >= 512 and page_bytes & (page_bytes - 1) == 0)
        self._page_bytes = 65536 if page_bytes == 1 else page_bytes if is_valid else 4096
        self._usable = self._page_bytes - (head[20] if len(head) > 20 and head[20] < 64 else 0)
        self._num_pages = -(-path.stat().st_size // self._page_bytes)

    def rows(self, table: Literal["topics", "messages"]) -> Iterator[Row]:
        """Yield the rows of a table by their ids; of two rows with one id, the one on the later page."""
        found: dict[tuple[int, str], Row] = {}
        with self._path.open("rb") as stream:
            for number in range(1, self._num_pages + 1):
                page = self._page(stream, number)
                for row, head in self._leaf(page, number):
                    if _table_of(head) == table:
                        # Two tables with the same column types number their rows separately.
                        found[row.rowid, "" if table == "messages" else str(row.offset)] = row
        for place in sorted(found):
            yield found[place]

    def read(self, row: Row) -> list[Any] | None:
        """Return the columns of a row, or None if a page of it is damaged."""
        with self._path.open("rb") as stream:
            page_at = row.offset // self._page_bytes * self._page_bytes
            stream.seek(page_at)
            page = stream.read(self._page_bytes)
            local = self._local_bytes(row.payload_bytes)
            at = row.offset - page_at
            payload = bytearray(page[at : at + local])
            if len(payload) < local:
                return None
            if local < row.payload_bytes:
                (following,) = struct.unpack_from(">I", page, at + local) if at + local + 4 <= len(page) else (0,)
                while len(payload) < row.payload_bytes:
                    # Page 1 is never an overflow page.
                    if not 1 < following <= self._num_pages:
                        return None
                    page = self._page(stream, following)
                    if len(page) < self._usable:
                        return None
                    (following,) = struct.unpack_from(">I", page, 0)
                    payload += page[4 : 4 + min(self._usable - 4, row.payload_bytes - len(payload))]
                if following != 0:
                    return None
        return _columns(bytes(payload))

    def spans(self, row: Row) -> list[tuple[int, int]]:
        """Return the bytes of a row that is sound: its leaf page's header and cell, and its overflow pages."""
        size = self._page_bytes
        leaf = row.offset // size * size
        found = [(leaf, leaf + size)]
        local = self._local_bytes(row.payload_bytes)
        if local < row.payload_bytes:
            with self._path.open("rb") as stream:
                page = self._page(stream, leaf // size + 1)
                (following,) = struct.unpack_from(">I", page, row.offset - leaf + local)
                while following:
                    found.append(((following - 1) * size, following * size))
                    (following,) = struct.unpack_from(">I", self._page(stream, following), 0)
        return found

    def _page(self, stream: Any, number: int) -> bytes:
        stream.seek((number - 1) * self._page_bytes)
        return bytes(stream.read(self._page_bytes))

    def _leaf(self, page: bytes, number: int) -> Iterator[tuple[Row, bytes]]:
        start = 100 if number == 1 else 0
        if len(page) < start + 8 or page[start] != _TABLE_LEAF:
            return
        (num_cells,) = struct.unpack_from(">H", page, start + 3)
        if start + 8 + 2 * num_cells > len(page):
            return
        for i in range(num_cells):
            (cell,) = struct.unpack_from(">H", page, start + 8 + 2 * i)
            if not start + 8 + 2 * num_cells <= cell < len(page):
                continue
            payload_bytes, at = _varint(page, cell)
            rowid, at = _varint(page, at)
            if not 0 < payload_bytes <= min(_MAX_ROW_BYTES, self._num_pages * self._page_bytes):
                continue
            offset = (number - 1) * self._page_bytes + at
            local = self._local_bytes(payload_bytes)
            if at + local <= len(page):
                yield Row(self, rowid - (1 << 64) if rowid >> 63 else rowid, offset, payload_bytes), page[at : at + 64]

    def _local_bytes(self, payload_bytes: int) -> int:
        # The rule of the file format.
        most = self._usable - 35
        if payload_bytes <= most:
            return payload_bytes
        least = (self._usable - 12) * 32 // 255 - 23
        local = least + (payload_bytes - least) % (self._usable - 4)
        return local if local <= most else least


def _table_of(head: bytes) -> str:
    # messages are (null, int, int, blob), topics (null, text, text, ...)
    types = _types(head)
    if types is None or len(types) < 4:
        return ""
    kinds = [_kind(code) for code in types]
    if len(kinds) == 4 and kinds[1] in ("int", "float") and kinds[2] == "int" and kinds[3] == "blob":
        return "messages"
    return "topics" if kinds[0] == "null" and kinds[1:4] == ["text"] * 3 and len(kinds) <= 8 else ""


def _kind(code: int) -> str:
    if code == 0:
        return "null"
    if code in (7, 10, 11):
        return "float" if code == 7 else ""
    return "int" if code < 10 else "blob" if code % 2 == 0 else "text"


def _types(payload: bytes) -> list[int] | None:
    size, at = _varint(payload, 0)
    if not at <= size <= len(payload):
        return None
    types = []
    while at < size:
        code, at = _varint(payload, at)
        types.append(code)
    return types


def _columns(payload: bytes) -> list[Any] | None:
    types = _types(payload)
    if types is None:
        return None
    at, _ = _varint(payload, 0)
    values: list[Any] = []
    for code in types:
        size = (0, 1, 2, 3, 4, 6, 8, 8, 0, 0)[code] if code < 10 else max(0, (code - 12) // 2)
        content = payload[at : at + size]
        if len(content) < size:
            return None
        at += size
        match _kind(code):
            case "int":
                values.append(code - 8 if code in (8, 9) else int.from_bytes(content, "big", signed=True))
            case "blob":
                values.append(content)
            case "text":
                values.append(content.decode("utf-8", errors="replace"))
            case "float":
                values.append(struct.unpack(">d", content)[0])
            case _:
                values.append(None)
    return values if at == len(payload) else None


def _varint(data: bytes, at: int) -> tuple[int, int]:
    # Big-endian in groups of seven bits.
    number = 0
    for i in range(9):
        if at >= len(data):
            return 0, at
        byte = data[at]
        at += 1
        if i == 8:
            return number << 8 | byte, at
        number = number << 7 | byte & 0x7F
        if byte < 0x80:
            return number, at
    return number, at
