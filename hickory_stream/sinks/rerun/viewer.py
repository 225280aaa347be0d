"""Choice and start of a viewer.

Every viewer is a separate process behind a URL: the wheel's binary is started with `--bind`, because the SDK's `spawn`
and `serve_web_viewer` listen on all interfaces.
"""

import os
import shutil
import socket
import subprocess
import sys
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from urllib.parse import quote, urlsplit

from hickory_stream.errors import ViewerError

_CHOICES = "auto, none, spawn, web, or connect=URL such as connect=rerun+http://127.0.0.1:9876/proxy"
_NO_SCREEN = (
    "--viewer spawn needs a screen, and neither DISPLAY nor WAYLAND_DISPLAY is set; "
    "use --viewer web to look from a browser, or --rrd FILE to look later"
)
_SCHEMES = ("rerun", "rerun+http", "rerun+https")
_GRPC_PORT, _WEB_PORT = 9876, 9090


class ViewerKind(StrEnum):
    """Kinds of viewers."""

    NONE = "none"
    SPAWN = "spawn"
    WEB = "web"
    CONNECT = "connect"


@dataclass(frozen=True, kw_only=True, slots=True)
class ViewerChoice:
    """A viewer; `url` is the address of a running one for CONNECT, else None."""

    kind: ViewerKind
    url: str | None = None


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Viewer:
    """A viewer's `url` for data, `web_url` for a browser, and its process if it was started here."""

    url: str
    web_url: str | None = None
    process: subprocess.Popen[bytes] | None = None
    outlives_us: bool = True


def parse_viewer(text: str) -> ViewerChoice:
    """Return the choice of `auto|none|spawn|web|connect=URL`; auto spawns if there is a screen.

    Raises `ViewerError` for another text, or a URL that is no viewer address.
    """
    if text == "auto":
        return ViewerChoice(kind=ViewerKind.SPAWN if has_screen() else ViewerKind.NONE)
    if text in (ViewerKind.NONE, ViewerKind.SPAWN, ViewerKind.WEB):
        return ViewerChoice(kind=ViewerKind(text))
    if text.startswith("connect="):
        return ViewerChoice(kind=ViewerKind.CONNECT, url=_viewer_url(text.removeprefix("connect=")))
    raise ViewerError(f"viewer {text!r} is none of these: {_CHOICES}")


def check_viewer(choice: ViewerChoice) -> None:
    """Raise `ViewerError` for a window without a screen, or an unknown host; a viewer may start to listen later."""
    if choice.kind is ViewerKind.SPAWN and not has_screen():
        raise ViewerError(_NO_SCREEN)
    if choice.url is None:
        return
    host, port = host_and_port(choice.url)
    try:
        socket.getaddrinfo(host, port)
    except (OSError, UnicodeError) as error:
        raise ViewerError(
            f"found --viewer connect={choice.url}: there is no host {host!r} (or no way to look it up); "
            f"expected {_CHOICES}"
        ) from error


def has_screen() -> bool:
    """Return whether a window can be opened here."""
    if sys.platform in ("darwin", "win32"):
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def start_viewer(choice: ViewerChoice, *, bind: str, server_memory_limit: str) -> Viewer | None:
    """Start the viewer if necessary, and return its addresses; None for no viewer.

    Raises `ViewerError` for a window without a screen, or without the viewer's binary.
    """
    match choice.kind:
        case ViewerKind.NONE:
            return None
        case ViewerKind.CONNECT:
            assert choice.url is not None
            return Viewer(url=choice.url)
        case ViewerKind.SPAWN:
            return _start_window(bind, server_memory_limit)
        case ViewerKind.WEB:
            return _start_web(bind, server_memory_limit)


def host_and_port(url: str) -> tuple[str, int]:
    """Return host and port of a viewer's URL."""
    parts = urlsplit(url)
    return parts.hostname or "127.0.0.1", parts.port or (443 if parts.scheme == "rerun+https" else _GRPC_PORT)


def viewer_binary() -> Path:
    """Return the wheel's native viewer (its Python wrapper would leave a process behind); raises `ViewerError`."""
    import importlib.util

    spec = importlib.util.find_spec("rerun_cli")
    name = "rerun.exe" if sys.platform == "win32" else "rerun"
    if spec is not None and spec.origin is not None and (beside := Path(spec.origin).with_name(name)).is_file():
        return beside
    found = shutil.which("rerun")
    if found is None:
        raise ViewerError("the Rerun viewer is not installed; install rerun-sdk from PyPI, or use --viewer none")
    return Path(found)


def free_port(preferred: int, bind: str = "127.0.0.1") -> int:
    """Return the preferred port if it is free, else one that the system chooses."""
    family = socket.AF_INET6 if ":" in bind else socket.AF_INET
    for port in (preferred, 0):
        with socket.socket(family, socket.SOCK_STREAM) as probe:
            try:
                probe.bind((bind, port))
            except OSError:
                continue
            return int(probe.getsockname()[1])
    raise ViewerError(f"no port can be opened on {bind}; name an address of this machine, such as 127.0.0.1")


def viewer_environment() -> dict[str, str]:
    """Return the environment of a viewer: RERUN_APP_ONLY suppresses its question about usage statistics."""
    return {**os.environ, "RERUN_APP_ONLY": "true"}


def _viewer_url(text: str) -> str:
    url = text if "://" in text else f"rerun+http://{text}/proxy"
    parts = urlsplit(url)
    try:
        usable = parts.scheme in _SCHEMES and bool(parts.hostname) and (parts.port or 1) > 0
    except ValueError:
        usable = False
    if not usable or parts.path != "/proxy":
        raise ViewerError(f"{text!r} is no address of a Rerun viewer; expected rerun+http://HOST:PORT/proxy")
    return url


def _start_window(bind: str, server_memory_limit: str) -> Viewer:
    if not has_screen():
        raise ViewerError(_NO_SCREEN)
    port = free_port(_GRPC_PORT, bind)
    process = _start(bind, port, server_memory_limit, ["--hide-welcome-screen", "--expect-data-soon"])
    return Viewer(url=f"rerun+http://{_reachable(bind)}:{port}/proxy", process=process)


def _start_web(bind: str, server_memory_limit: str) -> Viewer:
    port, web_port = free_port(_GRPC_PORT, bind), free_port(_WEB_PORT, bind)
    process = _start(bind, port, server_memory_limit, ["--serve-web", "--web-viewer-port", str(web_port)])
    url = f"rerun+http://{_reachable(bind)}:{port}/proxy"
    web_url = f"http://{_reachable(bind)}:{web_port}/?url={quote(url, safe='')}"
    return Viewer(url=url, web_url=web_url, process=process, outlives_us=False)


def _start(bind: str, port: int, server_memory_limit: str, options: list[str]) -> subprocess.Popen[bytes]:
    where = ["--bind", bind, "--port", str(port), "--server-memory-limit", server_memory_limit]
    return subprocess.Popen(
        [str(viewer_binary()), *where, *options],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env=viewer_environment(),
        # Ctrl-C in the terminal is for the mapping, not for the picture.
        start_new_session=True,
    )


def _reachable(bind: str) -> str:
    if bind in ("0.0.0.0", "::"):
        return "127.0.0.1"
    return f"[{bind}]" if ":" in bind else bind
