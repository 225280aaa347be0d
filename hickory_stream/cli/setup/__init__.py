"""Commands for models, generators, caches, configuration and schemas."""
