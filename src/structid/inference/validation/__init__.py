"""Validation: simulation-based calibration, and checks of a measurement against a model."""
