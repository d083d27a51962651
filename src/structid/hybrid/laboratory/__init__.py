"""Specimens: simulated, in another process, or behind a laboratory's server."""
