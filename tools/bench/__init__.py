"""Developer benchmarks: ``maslam bench``."""
