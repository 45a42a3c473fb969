"""Carries bytes and counts them; makes faults on purpose."""
