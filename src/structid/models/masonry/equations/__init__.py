"""Equations of motion of a wall, and their solution."""
