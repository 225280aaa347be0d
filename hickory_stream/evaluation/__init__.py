"""Scores of a map against truth, tables and pictures."""
