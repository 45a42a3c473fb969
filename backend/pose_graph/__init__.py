"""The pose graph as values, and g2o files."""
