"""Commands that examine a log."""
