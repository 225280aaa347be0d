"""Several robots mapped in one run: a process each, their maps joined while they grow, and one map at the end."""
