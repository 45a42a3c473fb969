"""Smooth camera poses along a line on the ground."""
