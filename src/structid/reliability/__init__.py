"""Passages of a limit over the parameters of a model and over its posterior, fragility, sensitivity."""
