"""Textured meshes: layer 2 with the pixels of the views that the map keeps."""

DEFAULT_TEXTURE_PX, LEAST_TEXTURE_PX, MOST_TEXTURE_PX = 1024, 32, 8192
"""The side of a texture where nothing else is said, and what may be said."""
