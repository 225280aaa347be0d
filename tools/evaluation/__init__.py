"""Evaluation that only the developers of the mapper need."""
