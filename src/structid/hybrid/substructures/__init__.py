"""Substructures: the parts into which a structure is divided."""
