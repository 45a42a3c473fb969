"""Distributed solvers as nodes without I/O: Gauss-Seidel, block descent, elected."""
