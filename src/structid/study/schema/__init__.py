"""Schema: what a study file may say, every key with its unit and default, and what is wrong in words."""
