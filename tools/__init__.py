"""The command line, synthetic worlds, evaluation, reports."""
