"""Chaos: polynomial families and sparse or shrunken expansions in them."""
