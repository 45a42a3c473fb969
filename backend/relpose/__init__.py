"""Verification of place matches."""
