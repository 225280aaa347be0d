"""Generators of shapes: programs of others, each in an environment of its own."""
