"""Hybrid simulation: a structure cut into a numerical and a physical part, and what it takes to run both as one."""
