"""What the figures of the READMEs come from; one module per name, each with `measure(options) -> list[Figure]`."""
