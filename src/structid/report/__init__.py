"""Reports: one self-contained page with figures and tables."""
