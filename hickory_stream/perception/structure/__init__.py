"""Structure: floor, walls, ceiling and ground, which are no objects."""
