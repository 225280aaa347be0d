"""Robots that are mapped while they move: messages as they arrive, by whatever route, as posed RGB-D frames.

`open_live(uri)` is the way in. A route (`transport.LiveSource`) only fetches bytes; what they mean is told by the same
code that reads logs.
"""

from players.live.opening import LiveMapSource, open_live

__all__ = ["LiveMapSource", "open_live"]
