"""Kinds of model that a study file can name."""
