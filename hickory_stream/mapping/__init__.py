"""The core: from events to effects. No I/O, no clock, no randomness."""
