"""The folder of a map: its files, their digest, and the history that the journal tells."""
