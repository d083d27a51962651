"""Finite elements of masonry: blocks, mortar joints, a loading beam."""
