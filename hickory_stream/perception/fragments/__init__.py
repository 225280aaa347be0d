"""Fragments: the over-segmentation of a frame that regions are joined from."""
