"""Procedural worlds with exact truth: kinds of objects, composed scenes, walks, a flawed depth camera, logs.

Everything follows from a seed and a config: the same two give the same bytes.
"""
