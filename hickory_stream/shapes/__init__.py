"""Layers 2 to 4: a mesh from what was kept of an object, superquadrics from the mesh, and their inflation."""
