"""Meshes of generative models: scale, placement and judgement against what was seen."""
