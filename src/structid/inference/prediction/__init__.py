"""Predictions from a posterior, on the measured record or another one."""
