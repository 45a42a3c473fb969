"""Exact elimination by messages: robots solve their own part, and pass on what it says about the poses they share."""
