"""Certificates: bounds on a posterior's moments from runs of the model itself at fresh draws."""
