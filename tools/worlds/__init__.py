"""Scenes, walks, layouts and flaws of synthetic recordings beyond the room of the demo."""
