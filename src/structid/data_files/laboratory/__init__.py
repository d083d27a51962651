"""Formats of loggers, test laboratories and structural programs."""
