"""Images to the five VO files: datasets, cameras, ORB, tracking, mapping, vocabulary."""
