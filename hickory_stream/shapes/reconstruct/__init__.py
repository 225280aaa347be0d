"""Layer 2: complete meshes from fused depth or from a single view."""
