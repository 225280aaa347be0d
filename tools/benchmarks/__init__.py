"""What the figures of the README come from; one module per name, each with `measure(options) -> list[Figure]`."""
