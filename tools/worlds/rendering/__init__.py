"""Ray casting, shading, light and sensors."""
