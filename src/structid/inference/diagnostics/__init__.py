"""Diagnostics of draws: convergence, residuals, identifiability, the verdict."""
