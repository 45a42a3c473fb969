"""Agents compared with ground truth, and the figures of ``summary.json``."""
