"""Meshes and a spoiling generator for shapes, and the slow reference of sweeps."""
