"""The paper's tables, measured: see README.md."""
