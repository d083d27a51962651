"""Campaigns of true runs: the loop over the runs, the executors, and the crash-safe store."""
