"""The exit statuses that are not a failure's own."""

STOPPED = 130
