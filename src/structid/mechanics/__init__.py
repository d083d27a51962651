"""Mechanics: constitutive laws of springs and joints, restoring forces, and time integration."""
