"""Scores of masks against labels, and the data that they are scored on."""
