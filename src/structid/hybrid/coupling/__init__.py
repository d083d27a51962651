"""Coupling of the numerical and the physical part, one step at a time."""
