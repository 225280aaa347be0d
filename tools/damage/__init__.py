"""Seeded damage to logs and maps, and the small sound ones that it is done to."""
