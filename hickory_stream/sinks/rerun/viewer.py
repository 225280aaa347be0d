"""Which viewer to show a run in, and how it is started.

Every viewer is a process of its own behind a URL: the native window and the web server are started from the binary of
the wheel with `--bind`, because the SDK's own `spawn` and `serve_web_viewer` listen on all interfaces.
"""

from __future__ import annotations

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
    """Where the live picture goes."""

    NONE = "none"
    SPAWN = "spawn"
    WEB = "web"
    CONNECT = "connect"


@dataclass(frozen=True, kw_only=True, slots=True)
class ViewerChoice:
    """A viewer; `url` is that of a running one for CONNECT, else None."""

    kind: ViewerKind
    url: str | None = None


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Viewer:
    """A viewer's `url` for data, the `web_url` for a browser, and its process where we started it."""

    url: str
    web_url: str | None = None
    process: subprocess.Popen[bytes] | None = None
    outlives_us: bool = True


def parse_viewer(text: str) -> ViewerChoice:
    """Return the choice that `auto|none|spawn|web|connect=URL` names; auto is spawn where there is a screen.

    Raises:
        ViewerError: the text names none of them, or the URL is no address of a viewer.
    """
    if text == "auto":
        return ViewerChoice(kind=ViewerKind.SPAWN if has_screen() else ViewerKind.NONE)
    if text in (ViewerKind.NONE, ViewerKind.SPAWN, ViewerKind.WEB):
        return ViewerChoice(kind=ViewerKind(text))
    if text.startswith("connect="):
        return ViewerChoice(kind=ViewerKind.CONNECT, url=_viewer_url(text.removeprefix("connect=")))
    raise ViewerError(f"viewer {text!r} is none of these: {_CHOICES}")


def check_viewer(choice: ViewerChoice) -> None:
    """Refuse what surely cannot be shown, before anything is played.

    A viewer that does not listen yet is none of it: it is shown the run as soon as it does.

    Raises:
        ViewerError: there is no screen for a window, or no host of that name.
    """
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
    """Start what the choice needs and return where it listens; None when nothing is to be shown.

    Raises:
        ViewerError: a window is asked for without a screen, or the viewer's binary is missing.
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
    """Return where the viewer of a URL listens."""
    parts = urlsplit(url)
    return parts.hostname or "127.0.0.1", parts.port or (443 if parts.scheme == "rerun+https" else _GRPC_PORT)


def viewer_binary() -> Path:
    """Return the native viewer of the wheel: its Python wrapper would leave the real process behind when it is ended.

    Raises:
        ViewerError: there is none.
    """
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
    """Return the preferred port if nobody listens there, else one that the system chooses."""
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
    """Return the environment of a viewer's process: RERUN_APP_ONLY leaves out its question about usage statistics."""
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
