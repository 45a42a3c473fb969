"""Robust selection of loops and separators."""
