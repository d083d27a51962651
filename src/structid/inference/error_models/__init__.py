"""Error models: how measurement and model may differ."""
