"""From the tables of a study file to records, priors, model, measurements, surrogate and sampler."""
