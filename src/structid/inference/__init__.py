"""Inference: error models, posterior, samplers, diagnostics, prediction."""
