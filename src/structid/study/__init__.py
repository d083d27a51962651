"""Studies: a TOML file that says a whole calibration in words, with units."""
