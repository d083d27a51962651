"""Kriging: correlation functions, hyper-parameters and the fitted predictor."""
