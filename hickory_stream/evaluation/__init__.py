"""How good a map is: synthetic worlds with truth, scores, tables and pictures."""
