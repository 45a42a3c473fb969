"""Key-frame in, better map out."""
