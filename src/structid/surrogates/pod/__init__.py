"""Response-space surrogates: principal components of histories, and a regression of each score."""
