"""Calibration of an expensive model: surrogate, posterior, model runs in the posterior's region, until a certificate holds."""
