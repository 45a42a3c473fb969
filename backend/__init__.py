"""Geometry of matches and graphs: verification, pose graphs, central and distributed optimisers, map fusion."""
