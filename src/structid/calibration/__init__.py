"""Calibration of an expensive model: surrogate, posterior, model runs where the posterior is, until a certificate holds."""
