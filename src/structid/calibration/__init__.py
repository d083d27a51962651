"""Calibration of an expensive model: surrogate, posterior, true runs where the posterior is, until a certificate holds."""
