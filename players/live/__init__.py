"""Live robots: messages as they arrive, by any route, become posed RGB-D frames.

`open_live(uri)` is the entry point. A route (`transport.LiveSource`) fetches bytes; the code for logs decodes them.
"""

from players.live.opening import LiveMapSource, open_live

__all__ = ["LiveMapSource", "open_live"]
