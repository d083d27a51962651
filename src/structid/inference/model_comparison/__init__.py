"""Comparison of model classes by evidence and by predictive density."""
