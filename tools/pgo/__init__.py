"""``maslam pgo`` and its pictures: pose graphs of one or many robots, solved centrally or by message."""
