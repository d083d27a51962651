"""Likelihood: what was measured, the law of the discrepancy, the posterior."""
