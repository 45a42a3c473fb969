"""What images themselves say of a sequence: its light, its pairs, its depth, its calibration."""
