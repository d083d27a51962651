"""First passages of a limit, fragility and sensitivity, over a prior or a posterior."""
