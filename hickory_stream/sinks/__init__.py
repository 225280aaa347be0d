"""Sinks: where snapshots go, to be looked at or to be kept."""
