"""Other programs' results in (``maslam import``), results for other programs out (``maslam export``)."""
