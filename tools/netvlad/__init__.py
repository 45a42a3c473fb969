"""``maslam netvlad``: train, export, calibrate, evaluate and use the place descriptor."""
