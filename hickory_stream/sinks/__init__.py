"""Sinks: consumers that show or store snapshots."""
