"""Images to NetVLAD vectors: ONNX inference and its container; training and export apart."""
