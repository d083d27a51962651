"""Likelihood and posterior: observations, their likelihoods, the posterior, the misfit."""
