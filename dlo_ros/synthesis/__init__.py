"""Simulated experiments of known truth, made by another rod model than the package's own."""
