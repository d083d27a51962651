"""Compiled lanes: many runs of one loop over time on a CPU, one run in each lane of a vector."""
