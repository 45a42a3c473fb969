"""A tree of ORB words (DBoW2): its use, its text form, its training."""
