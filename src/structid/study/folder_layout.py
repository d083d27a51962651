"""The files in the folder of every study. Each stage defines the names of its own files."""

from __future__ import annotations

IDENTITY = "identity.json"
"""All inputs on which a study depends, and their location."""

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
"""Draws from a sampler, without a certified calibration."""

SURROGATE = "surrogate.h5"
"""The fitted surrogate."""

SCRATCH = "scratch"
"""Folder for the files of external model runs."""
