"""Loops: where the robot came back, and how the map then lies in itself."""
