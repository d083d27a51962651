"""Sections of the page of a cyclic test, one file per section."""
