"""Studies of quasi-static cyclic tests: choice of the hysteretic law, from the study file to the report."""
