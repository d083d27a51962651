"""Sampling: the samplers, their moves, and their draws on disk."""
