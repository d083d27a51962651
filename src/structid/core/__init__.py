"""Tools that every room uses: errors, checks of arguments, units, names, random streams, files that survive a kill."""
