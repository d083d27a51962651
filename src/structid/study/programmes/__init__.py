"""Programmes of hybrid tests, from the programme file to the report."""
