"""Messages: decoding of images, depth, calibration and point clouds."""
