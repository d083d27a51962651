"""Sampling: the samplers, their moves, their draws on disk."""
