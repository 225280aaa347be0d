"""Examination of a live route: it is recorded for some seconds, then examined as a log."""

import tempfile
from collections.abc import Callable
from pathlib import Path

from hickory_stream.errors import InputError
from players.doctor.diagnosis import Diagnosis, examine_log
from players.live.inbox import Inbox
from players.live.live_log import LiveLog
from players.live.opening import subscribe
from players.live.recorder import Recorder
from players.live.routes import route_of
from players.live.status import LiveStatus, status_of, status_table
from players.live.transport import LiveSource
from players.opening import open_container
from players.options import SourceOptions

_MOST_BYTES = 4_000_000_000
_STEP_S = 0.25


def examine_live(
    uri: str,
    options: SourceOptions,
    progress: Callable[[str], None] = lambda stage: None,
    *,
    seconds: float = 10.0,
    route: LiveSource | None = None,
) -> Diagnosis:
    """Return the diagnosis of a live route after `seconds`; faults are in the result, not raised.

    `route` replaces the route of the address.
    """
    found = Diagnosis(uri=uri)
    try:
        route = route or route_of(uri)
    except InputError as error:
        found.refusal = str(error)
        return found
    with tempfile.TemporaryDirectory(prefix="hickory-doctor-") as folder:
        path = Path(folder) / "heard.mcap"
        try:
            status, refusal = _listen(route, path, options, progress, seconds)
        except InputError as error:
            found.refusal = str(error)
            return found
        if any(entry.received for entry in status.topics):
            found.num_bytes = path.stat().st_size
            examine_log(found, open_container(path), options, progress, is_heard=True)
            found.kind = status.kind
            _rename(found, path, refusal)
        else:
            found.refusal = refusal or f"{uri} has sent nothing"
    _note_status(found, status)
    return found


def _listen(
    route: LiveSource, path: Path, options: SourceOptions, progress: Callable[[str], None], seconds: float
) -> tuple[LiveStatus, str | None]:
    recorder = Recorder(path, route.uri, limit_bytes=_MOST_BYTES)
    inbox = Inbox(tap=recorder.take)
    log = LiveLog(route, inbox)
    refusal: str | None = None
    try:
        route.start(inbox)
        ends_ns = inbox.clock() + round(seconds * 1e9)
        while (left_ns := ends_ns - inbox.clock()) > 0 and not inbox.is_over:
            progress(f"listening for {left_ns / 1e9:.0f} s more")
            try:
                subscribe(route, log, options)
                refusal = None
            except InputError as error:
                refusal = str(error)
            log.idle(min(_STEP_S, max(0.0, left_ns / 1e9)))
        health = route.health()
        if not inbox.topics and (health.problem or inbox.end_reason):
            refusal = inbox.end_reason or health.problem
        return status_of(route, log), refusal
    finally:
        log.end()
        route.stop()
        recorder.close()


def _rename(found: Diagnosis, path: Path, refusal: str | None) -> None:
    found.refusal = refusal or (found.refusal.replace(str(path), found.uri) if found.refusal is not None else None)
    found.problems = [text.replace(str(path), found.uri) for text in found.problems]
    found.notes = [text.replace(str(path), found.uri) for text in found.notes]


def _note_status(found: Diagnosis, status: LiveStatus) -> None:
    found.live = {**status.as_dict(), "table": status_table(status).splitlines()}
    del found.live["event"]
    note = status.problem or ("the stream has ended" if status.has_ended else "")
    found.notes += [note] if note else []
    found.problems += [f"{entry.topic}: {entry.problem}" for entry in status.topics if entry.problem]
