"""Programmes of hybrid tests, from their file to their report."""
