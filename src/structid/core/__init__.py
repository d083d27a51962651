"""Tools for all subpackages: errors, argument checks, units, names, random streams, crash-safe files."""
