"""Other programs' results in: ``maslam import``."""
