"""Random rooms full of random things, in two families that share no recipe: training and tuning."""
