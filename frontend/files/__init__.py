"""TUM, KITTI, the five VO files, text tables."""
