"""Mechanics: laws of springs, integrators over a record; nothing of models."""
