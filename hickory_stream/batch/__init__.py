"""Many logs: each a task of its own on local processes or a cluster, one table of results, one merged map."""
