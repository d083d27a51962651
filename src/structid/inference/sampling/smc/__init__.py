"""Tempered sequential Monte Carlo: from the prior to the posterior by degrees, with the evidence."""
