"""What a map consists of: tracks, clouds, views, submaps and the observed space."""
