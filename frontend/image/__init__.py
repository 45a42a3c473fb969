"""Key-points, optical flow, patch alignment, guided matching."""
