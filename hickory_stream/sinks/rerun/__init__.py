"""The Rerun sink: every layer of the map on a timeline."""
