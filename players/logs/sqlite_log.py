"""sqlite3 files of ROS 2 bags, whole or damaged; they have no checksums.

SQLite reads a sound file. For a damaged one, `sqlite_pages` finds every message whose own pages are whole.
"""

import sqlite3
from collections.abc import Collection, Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import Any
from urllib.parse import quote

from hickory_stream.errors import RecordingError
from players.logs.containers import LogMessage, Topic, merged_topics, normalized_type, summed_by, topic_name
from players.logs.decompression import UnpackError, unpack_message
from players.logs.log_damage import Flaws
from players.logs.log_parts import Parts
from players.logs.sqlite_pages import PageFile

_TOPIC_COLUMNS = ("id", "name", "type", "serialization_format")


class SqliteLog:
    """A `Log` in one sqlite3 file of rosbag2."""

    kind = "ROS 2 bag (sqlite3)"
    checksum = ""
    #: What is read of a long log; None: all.
    parts: Parts | None = None

    def __init__(self, path: Path, definitions: dict[str, str] | None = None) -> None:
        """Read the topics; `definitions` are message definitions by type, for types missing from the bag's own table.

        Raises `RecordingError`: no topic can be read, or it is a database of something else.
        """
        self.path = path
        self.files = (path,)
        self.flaws = Flaws(path.name)
        self._definitions = definitions or {}
        self._is_sound = True
        self._counts: dict[int, int] | None = None
        try:
            self.topic_rows, self._counts = self._read_topics()
        except sqlite3.DatabaseError as error:
            self._give_up(error)
            pages = PageFile(path)
            self.topic_rows = {}
            for row in pages.rows("topics"):
                values = row.values()
                if values is None or len(values) < 4 or not all(isinstance(value, str) for value in values[1:4]):
                    continue
                # Rows of topics and of message definitions have the same columns; a topic's name begins with a slash.
                if values[1].startswith("/"):
                    self.topic_rows[row.rowid] = (values[1], values[2], values[3])
                elif values[2] in ("ros2msg", "ros2idl"):
                    self._definitions.setdefault(values[1], values[3])
            if not self.topic_rows:
                raise RecordingError(
                    f"{path} cannot be read as a ROS 2 bag: {error}, and no page of it holds topics"
                ) from error
        self.topics = merged_topics([self._topic(number) for number in sorted(self.topic_rows)])

    def declared(self) -> dict[str, int] | None:
        """Return the number of messages of each topic in the database, None if it is damaged."""
        return summed_by(lambda number: self.topic_rows.get(number, ("",))[0], self._counts)

    def span_ns(self) -> tuple[int, int] | None:
        """Return the first and the last log time; None for a damaged or empty database."""
        if not self._is_sound:
            return None
        with suppress(sqlite3.DatabaseError), _connected(self.path) as connection:
            # Two queries, each of which the index answers.
            first, last = (
                connection.execute(f"SELECT {end}(timestamp) FROM messages").fetchone()[0] for end in ("min", "max")
            )
            if isinstance(first, int) and isinstance(last, int):
                return first, last
        return None

    def messages(self, topics: Collection[str]) -> Iterator[LogMessage]:
        """Yield the messages of some topics in the order of the rows; unreadable ones are noted in `flaws`."""
        names = {number: row[0] for number, row in self.topic_rows.items() if row[0] in topics}
        last, parts = -(1 << 63), self.parts
        if self._is_sound:
            try:
                for rowid, topic_id, log_ns, data in self._select(names):
                    last = rowid
                    if parts is not None and not parts.wants(names[topic_id], log_ns):
                        continue
                    message = self._message(names[topic_id], log_ns, data, rowid)
                    if message is not None:
                        yield message
            except sqlite3.DatabaseError as error:
                self._give_up(error)
            else:
                return
        for row in PageFile(self.path).rows("messages"):
            if row.rowid <= last:
                continue
            values = row.values()
            if values is None:
                self.flaws.note(row.offset, f"row {row.rowid} lies in pages that are damaged", 0, num_unknown=1)
            elif (
                len(values) >= 4 and values[1] in names and isinstance(values[2], int) and isinstance(values[3], bytes)
            ):
                message = self._message(names[values[1]], values[2], values[3], row.rowid)
                if message is not None:
                    yield message
            elif len(values) < 4 or values[1] not in self.topic_rows:
                self.flaws.note(row.offset, f"row {row.rowid} is no message", 0, num_unknown=1)

    def _message(self, name: str, log_ns: int, data: Any, rowid: int) -> LogMessage | None:
        if not isinstance(data, bytes):
            self.flaws.note(rowid, f"row {rowid} holds no bytes", 0, {name: 1})
            return None
        try:
            return LogMessage(name, log_ns, unpack_message(data))
        except UnpackError as error:
            self.flaws.note(rowid, f"the message in row {rowid} {error}", len(data), {name: 1})
            return None

    def _select(self, names: dict[int, str]) -> Iterator[tuple[int, int, int, Any]]:
        query = f"SELECT id, topic_id, timestamp, data FROM messages WHERE topic_id IN ({','.join(map(str, names))})"
        parts = self.parts
        if parts is not None:
            whole = ",".join(str(number) for number, name in names.items() if name in parts.whole)
            spans = "".join(f" OR timestamp BETWEEN {first_ns} AND {last_ns}" for first_ns, last_ns in parts.spans())
            query += f" AND (topic_id IN ({whole}){spans})"
        with _connected(self.path) as connection:
            yield from connection.execute(f"{query} ORDER BY id")

    def _read_topics(self) -> tuple[dict[int, tuple[str, str, str]], dict[int, int]]:
        with _connected(self.path) as connection:
            tables = {row[0] for row in connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
            if not {"topics", "messages"} <= tables:
                found = ", ".join(sorted(tables)) or "none"
                raise RecordingError(
                    f"{self.path} is a database, but no ROS 2 bag: expected the tables topics and messages, "
                    f"found {found}"
                )
            rows = {
                row[0]: (topic_name(row[1]), row[2], row[3])
                for row in connection.execute(f"SELECT {', '.join(_TOPIC_COLUMNS)} FROM topics")
            }
            if "message_definitions" in tables:
                found_definitions = connection.execute(
                    "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
                )
                for type_name, encoding, definition in found_definitions:
                    if encoding in ("ros2msg", "ros2idl") and definition:
                        self._definitions.setdefault(type_name, definition)
            counts = dict(connection.execute("SELECT topic_id, count(*) FROM messages GROUP BY topic_id"))
        return rows, counts

    def _topic(self, number: int) -> Topic:
        name, type_name, wire = self.topic_rows[number]
        definition = self._definitions.get(type_name, "")
        is_idl = "IDL:" in definition[:400]
        return Topic(
            name=name,
            type_name=normalized_type(type_name),
            num_messages=None if self._counts is None else self._counts.get(number, 0),
            wire="cdr" if wire == "cdr" else "other",
            definition_format="none" if not definition else "idl" if is_idl else "msg",
            definition=definition,
        )

    def _give_up(self, error: Exception) -> None:
        self._is_sound = False
        self.flaws.note(0, f"SQLite gives up ({error}); its pages are read one by one", 0)


@contextmanager
def _connected(path: Path) -> Iterator[sqlite3.Connection]:
    wal = path.with_name(path.name + "-wal")
    # A write-ahead log beside the file may hold messages too.
    mode = "mode=ro" if wal.is_file() and wal.stat().st_size else "mode=ro&immutable=1"
    with closing(sqlite3.connect(f"file:{quote(str(path.resolve()))}?{mode}", uri=True)) as connection:
        # The schema of a bag is fixed; triggers and functions in a damaged or hostile file must not run.
        connection.execute("PRAGMA trusted_schema = OFF")
        yield connection
