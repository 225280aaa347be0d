"""Procedural worlds with exact truth: objects, scenes, walks, cameras with realistic defects, and logs.

Everything is determined by a seed and a config: the same two give the same bytes.
"""
