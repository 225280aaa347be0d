"""Queries of a finished map: the content of a position or pixel, and its history."""
