"""Camera models, calibration files, rectification."""
