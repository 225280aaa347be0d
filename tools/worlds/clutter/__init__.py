"""Random rooms full of random things, in three families that share no recipe: training, tuning, reporting."""
