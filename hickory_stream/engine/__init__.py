"""The event loop of a run; no other package uses asyncio."""
