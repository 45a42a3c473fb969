"""The RUN folder: TUM, g2o, PLY, COLMAP and CSV files of a run."""
