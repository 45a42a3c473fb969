"""Two levels: each robot's own poses, and a coarse level of knots along all robots' tracks."""
