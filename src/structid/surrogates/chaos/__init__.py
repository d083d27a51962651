"""Polynomial chaos: orthonormal polynomials, and sparse or shrunken expansions in them."""
