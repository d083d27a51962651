"""Tempered sequential Monte Carlo: from the prior to the posterior by tempering steps, with the evidence."""
