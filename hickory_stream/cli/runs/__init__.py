"""Commands that map a log or a camera."""
