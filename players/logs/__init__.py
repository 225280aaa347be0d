"""Logs: containers, topics, clocks and synchronised frames."""
