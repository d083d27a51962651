"""Hysteretic laws of springs: force against deformation and its history."""
