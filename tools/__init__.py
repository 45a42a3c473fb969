"""What people run: the command line, synthetic worlds, evaluation, reports."""
