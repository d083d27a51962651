"""Builders of records, priors, model, measurements, surrogate and sampler from the tables of a study file."""
