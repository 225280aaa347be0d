"""Regions: fragments that decision trees join into instances."""
