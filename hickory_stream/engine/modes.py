"""The two ways to run: a "playback" waits wherever something is full, a "live" run waits for nothing."""

from __future__ import annotations

from typing import Literal

Mode = Literal["playback", "live"]
