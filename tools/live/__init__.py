"""One agent with a camera that goes on: frames in as they come, key-frames and poses out."""
