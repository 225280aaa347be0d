"""Simulated maps of objects with known transforms between them: what alignment is measured on."""
