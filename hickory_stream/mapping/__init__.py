"""The core of the mapper: takes events, returns effects. No I/O, no clock, no randomness."""
