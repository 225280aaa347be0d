"""Shape jobs: the queue, the worker processes, the cache, and the generators of meshes."""
