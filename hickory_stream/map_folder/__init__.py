"""The folder of a map: its files, their digest, and the run's history in the journal."""
