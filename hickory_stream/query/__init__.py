"""Questions to a map about size, shape, colour, height and relations of its objects."""
