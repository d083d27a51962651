"""Hybrid simulation: a structure divided into a numerical and a physical part, and the experiment that couples them."""
