"""Sections of the page of a model comparison, one file per section."""
