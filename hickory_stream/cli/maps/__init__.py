"""Commands that ask, draw, export, compare and align finished maps."""
