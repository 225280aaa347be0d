"""Poses where a log has none, and poses that fit the map: odometry by registration of point clouds."""
