"""First passages of a limit over a prior and over a posterior, fragility, sensitivity."""
