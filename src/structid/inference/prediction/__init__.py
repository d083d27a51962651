"""Predictions from a posterior, for the measured record or another record."""
