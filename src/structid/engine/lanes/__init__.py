"""Compiled vector code: many runs of one loop over time on a CPU, one run in each lane of a SIMD vector."""
