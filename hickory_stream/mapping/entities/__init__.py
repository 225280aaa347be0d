"""The parts of a map: tracks, clouds, views, submaps and the observed space."""
