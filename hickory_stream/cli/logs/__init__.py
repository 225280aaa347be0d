"""Commands that look at a log."""
