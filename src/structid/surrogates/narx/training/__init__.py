"""Training of a NARX: selection of terms, and their coefficients."""
