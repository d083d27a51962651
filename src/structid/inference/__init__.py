"""Inference: discrepancy, posterior, samplers, diagnostics, prediction."""
