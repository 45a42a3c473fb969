"""``maslam calibrate``: a camera from a film of a board."""
