"""Masonry walls of blocks and cohesive joints."""
