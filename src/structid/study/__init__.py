"""Studies: a TOML file that describes a whole calibration, with units."""
