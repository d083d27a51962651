"""Kriging: correlation functions, hyper-parameters, the fitted predictor."""
