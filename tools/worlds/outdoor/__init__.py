"""A street and a lawn from a seed: uneven ground, kerbs, trunks, parked cars, what stands about outdoors."""
