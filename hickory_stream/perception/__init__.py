"""From a keyframe to observations: instance masks, their lift to 3D, patch features, free space and structure."""
