"""Maps of several sessions and robots made into one."""
