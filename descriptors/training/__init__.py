"""Training of the place descriptor and its export to ONNX; needs torch."""
