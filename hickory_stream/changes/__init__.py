"""Changes of objects between two maps of one place: still there, moved, gone, new, exchanged, or not seen."""
