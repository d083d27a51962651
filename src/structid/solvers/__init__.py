"""Solvers: other people's models, run one at a time in guarded child processes."""
