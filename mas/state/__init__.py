"""What one agent knows: key-frames, place matches, pose graph."""
