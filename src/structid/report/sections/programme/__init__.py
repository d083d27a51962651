"""Sections of the page of a programme of hybrid tests, one file per section."""
