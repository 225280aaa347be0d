"""From a keyframe to observations: masks, their lift to 3D, patch features, and what the frame says of space."""
