"""Figures: pure functions of arrays and names, called by the `.plot()` methods of objects."""
