"""``maslam inspect`` and ``maslam doctor``."""
