"""Recordings read without unpacking: films, and bags of ROS 1 and ROS 2."""
