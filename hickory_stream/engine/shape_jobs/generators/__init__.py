"""Generators of shapes: foreign programs, each in its own environment."""
