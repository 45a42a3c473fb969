"""Which measurements to believe: pairwise consistency (PCM) and graduated non-convexity (GNC)."""
