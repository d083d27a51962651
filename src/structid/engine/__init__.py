"""The numerical engine: JAX, loops over time, and their compilation for many runs at once. It contains no mechanics."""
