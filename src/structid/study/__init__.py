"""Studies: each study is a TOML file that describes a whole calibration, with units."""
