"""Campaigns of true runs: a crash-safe store, executors, and the loop between them."""
