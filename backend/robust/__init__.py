"""Which edges to believe: robust selection of loops and separators."""
