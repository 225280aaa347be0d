"""How the network of affinities is made: frames of synthetic worlds, lessons from them, training, eight-bit export."""
