"""Products and solutions with dense or sparse matrices that all runs share, as loops that compile to vector code."""
