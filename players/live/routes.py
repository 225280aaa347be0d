"""Routes by the scheme of an address."""

from pathlib import Path

from hickory_stream.errors import RecordingError
from players.live.transport import LiveSource

KNOWN = (
    "zenoh://HOST[:7447][/NAMESPACE], foxglove://HOST[:8765], zed://[SERIAL], zed://IP:PORT, zed:FILE.svo2, "
    "dds://[DOMAIN], mcap:PIPE, or - for an MCAP stream on standard input"
)


def is_live(uri: str) -> bool:
    """Return whether an address names a live route: it has a scheme, and no file has its name."""
    return uri == "-" or (uri.startswith(("mcap:", "zed:")) and not Path(uri).exists()) or "://" in uri


def is_recording(uri: str) -> bool:
    """Return whether an address waits for its reader, so that nothing need be left out."""
    return uri.startswith("zed:") and not uri.startswith("zed://")


def route_of(uri: str) -> LiveSource:
    """Return the route that an address names, not started yet. Raises `RecordingError`: it names none."""
    from players.live.mcap_stream import McapStream

    if uri == "-":
        return McapStream("-", None)
    if uri.startswith("mcap:"):
        path = Path(uri.removeprefix("mcap:"))
        if not path.exists() or path.is_dir():
            found = "a folder" if path.is_dir() else "no such file or pipe"
            raise RecordingError(f"{uri}: found {found}, expected a pipe (mkfifo {path}) or a file that grows")
        return McapStream(uri, path)
    if uri.startswith("zenoh://"):
        from players.live.zenoh_route import ZenohRoute

        return ZenohRoute(uri)
    if uri.startswith("foxglove://"):
        from players.live.foxglove_route import FoxgloveRoute

        return FoxgloveRoute(uri)
    if uri.startswith("dds:"):
        from players.live.dds_route import DdsRoute

        return DdsRoute(uri)
    if uri.startswith("zed:"):
        from players.live.zed_route import ZedRoute

        return ZedRoute(uri)
    raise RecordingError(f"found {uri}, expected one of {KNOWN}")
