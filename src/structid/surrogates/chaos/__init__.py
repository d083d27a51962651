"""Polynomial chaos: orthonormal polynomials, and sparse expansions or expansions with shrunk coefficients."""
