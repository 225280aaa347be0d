"""Many logs as tasks on local processes or a cluster, one table of results, one merged map."""
