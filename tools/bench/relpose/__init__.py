"""``maslam bench relpose``: verification of place matches on rendered pairs."""
