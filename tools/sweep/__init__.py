"""Experiments: sequences x agents x presets x seeds, to tables and figures."""
