"""Knowledge of one agent: key-frames, place matches, pose graph."""
