"""Compiled kernels: pose, window bundle adjustment, triangulation, two views; robust absolute pose."""
