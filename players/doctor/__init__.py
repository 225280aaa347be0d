"""The doctor: what a log lacks before it is mapped."""
