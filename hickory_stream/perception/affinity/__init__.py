"""Affinities of neighbouring pixels, from a small network."""
