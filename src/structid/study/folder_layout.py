"""The files in the folder of every study. A stage names its own files itself."""

from __future__ import annotations

IDENTITY = "identity.json"
"""Everything on which a study depends, and the location of its inputs."""

STUDY = "study.toml"
"""The study file."""

INPUTS = "inputs"
"""Copies of the input files."""

TIMINGS = "timings.json"
"""Duration of every stage."""

FIGURES = "figures"
"""Figures of the page."""

POSTERIOR = "posterior.nc"
"""Draws and predictions in the ArviZ schema."""

CHAINS = "chains.h5"
"""Draws of a sampling without calibration."""

SURROGATE = "surrogate.h5"
"""The fitted surrogate."""

SCRATCH = "scratch"
"""Files of model runs."""
