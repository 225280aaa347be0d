"""The notice for a map whose run did not end: its extent, and the command that resumes it."""

from __future__ import annotations

import shlex
from typing import TYPE_CHECKING

from hickory_stream.errors import MapFolderError

if TYPE_CHECKING:
    from pathlib import Path

    from hickory_stream.map_folder.saved_map import SavedMap


def resume_command(folder: Path) -> str:
    """Return the command line that resumes the run of a map."""
    return f"hickory-stream resume {shlex.quote(str(folder))}"


def unfinished_note(saved: SavedMap) -> str | None:
    """Return the notice of a map's run, None if it has ended or cannot be resumed."""
    mode = saved.manifest.run.get("mode")
    if saved.manifest.finished_cleanly or mode is None:
        return None
    from hickory_stream.journal.reader import Journal
    from hickory_stream.map_folder.layout import check_unlocked

    try:
        with Journal(saved.folder) as journal:
            steps = len(journal)
    except MapFolderError:
        return None
    objects = len(saved.snapshot.objects)
    # Saved snapshots have a revision of 1 or more.
    known = f"{objects} objects as of its last save" if saved.snapshot.revision else "nothing was saved yet"
    journal_text = f"its journal holds {steps} keyframe{'' if steps == 1 else 's'}"
    try:
        check_unlocked(saved.folder)
    except MapFolderError:
        return f"{saved.folder} is being written: {known}, {journal_text}"
    action = "save it with" if mode == "live" else "continue with"
    look = " (`inspect --at` shows any time of it)" if steps else ""
    return f"the run of {saved.folder} did not end: {known}, {journal_text}{look}; {action}: " + resume_command(
        saved.folder
    )
