"""Synthetic worlds and ``maslam render``."""
