"""The pose graph: where submaps lie, from odometry, gravity and loops."""
