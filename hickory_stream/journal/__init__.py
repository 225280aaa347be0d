"""The journal of a run: the events of every step in one file, from which any moment is restored."""
