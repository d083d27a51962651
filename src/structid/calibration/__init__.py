"""Calibration of a dear model: surrogate, posterior, true runs where the posterior is, until a certificate holds."""
