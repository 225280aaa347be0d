"""Alignment of two overlapping object maps: scores, consensus, acceptance, refinement."""
