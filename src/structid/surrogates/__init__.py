"""Surrogates: inexpensive models fitted to runs of an expensive model."""
