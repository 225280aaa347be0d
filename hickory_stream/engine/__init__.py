"""The engine: the only package that knows asyncio, and the map folder that a run leaves behind."""
