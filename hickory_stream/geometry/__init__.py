"""Pure geometry: no I/O, no state; numpy, scipy and numba only."""
