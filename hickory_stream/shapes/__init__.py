"""Layers 2 to 4: a mesh from an object's kept views and points, superquadrics fitted to it, and their inflation."""
