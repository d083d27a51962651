"""Kriging: correlations and the predictor they give."""
