"""``maslam bench vo``: accuracy, time and memory of the odometry."""
