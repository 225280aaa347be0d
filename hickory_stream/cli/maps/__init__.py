"""Commands that query, draw, export, compare and align finished maps."""
