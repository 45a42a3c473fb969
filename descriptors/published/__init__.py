"""Weights that other people published, read and exported."""
