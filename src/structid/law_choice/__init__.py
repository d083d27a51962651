"""Choice of the hysteretic law of a specimen from its cyclic test."""
