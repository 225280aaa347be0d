"""Questions to a finished map: what is at a place or pixel, and why."""
