"""The HTML page of a run, its recording for rerun, its summary table."""
