"""Schema: the keys of a study file with units and defaults, and error messages for mistakes."""
