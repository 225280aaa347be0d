"""Exit statuses of commands."""

STOPPED = 130
NO_ALIGNMENT = 3
NO_PATH = 3
NO_ANSWER = 3
NOT_SOUND = 1
INCOMPLETE = 3
