"""Build: from the words of a study file to records, priors, model, measurements, surrogate and sampler."""
