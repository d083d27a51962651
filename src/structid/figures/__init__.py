"""Figures: pure functions of arrays and names; `.plot()` of any object calls down to them."""
