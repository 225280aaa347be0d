"""How good a map is: scores against truth, tables and pictures."""
