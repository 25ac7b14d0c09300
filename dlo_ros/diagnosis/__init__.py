"""Diagnosis: what the model gets wrong, which physical cause it has, and what naming it gains."""
