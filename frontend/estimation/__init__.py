"""Compiled kernels: pose, window bundle adjustment, triangulation, two views; the pycolmap adapter."""
