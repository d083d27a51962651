"""Training of a NARX: which terms it has, and their coefficients."""
