"""Matrix products and linear solves that compile to vector code, for dense and sparse matrices."""
