"""A building from a seed: storeys of furnished rooms along a corridor, a stairwell, and long walks with returns."""
