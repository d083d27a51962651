"""Mechanics: constitutive laws of springs and joints, restoring forces, time integration."""
