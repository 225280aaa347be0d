"""Parts that know nothing of maps: files, text, JSON, caches and compiled kernels."""
