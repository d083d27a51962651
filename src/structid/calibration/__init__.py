"""Calibration of an expensive model by a surrogate, which new model runs improve until a certificate is issued."""
