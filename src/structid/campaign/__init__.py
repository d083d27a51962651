"""Campaigns of model runs: the loop over the runs, the executors, the crash-safe store."""
