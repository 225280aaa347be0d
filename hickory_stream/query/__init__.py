"""Questions to a map, answered by what the map holds: size, shape, colour, height and relations of its objects."""
