"""Poses: transforms, tracks, extrinsics and pose files, interpolated to frames."""
