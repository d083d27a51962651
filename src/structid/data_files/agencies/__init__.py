"""Formats of strong-motion networks and of programs that simulate or process ground motions."""
