"""Error models: the difference between measurement and model as a random process."""
