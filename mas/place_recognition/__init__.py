"""Operation 1: ask other agents for places, answer, verify, close own loops."""
