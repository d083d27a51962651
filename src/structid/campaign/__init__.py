"""Campaigns of model runs: the loop over the runs, the executors, and a store that survives a crash."""
