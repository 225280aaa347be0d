"""The steps of a keyframe, each of which takes the state to the next by the rules."""
