"""Collision checks among the inflated superquadrics of a map."""
