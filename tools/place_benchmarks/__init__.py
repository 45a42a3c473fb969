"""Test sets of place recognition: public, own and rendered ones."""
