"""Figures of a report as vector drawings."""
