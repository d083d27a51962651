"""NARX models: recursions in time whose coefficients are functions of the parameters."""
