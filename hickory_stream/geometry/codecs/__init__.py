"""Compact storage of voxels, depths, colours and meshes, each restored to the bit."""
