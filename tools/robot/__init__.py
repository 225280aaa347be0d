"""A simulated robot: a log published as a robot would, over a link with configurable faults."""
