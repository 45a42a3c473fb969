"""Operation 2: call for an optimisation, plan it, run the distributed solver."""
