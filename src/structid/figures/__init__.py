"""Figures: pure functions of arrays and names, called by the `.plot()` of objects."""
