"""Tools for all subpackages: errors, checks of arguments, units, names, random streams, files that survive a kill."""
