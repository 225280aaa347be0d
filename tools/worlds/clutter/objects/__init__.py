"""The shapes of random rooms: one function a recipe, in modules by use."""
