"""Sources: recorded logs and image folders as posed RGB-D frames.

`open_source(uri)` is the entry point; it returns a `hickory_stream.ports.Source`.
"""

from players.opening import open_source
from players.options import SourceOptions
from players.source_note import make_source_note, open_from_note

__all__ = ["SourceOptions", "make_source_note", "open_from_note", "open_source"]
