"""The doctor: faults of a log, found before it is mapped."""
