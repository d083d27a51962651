"""Products and solutions with matrices that all runs share, dense or sparse, as loops that compile to lanes."""
