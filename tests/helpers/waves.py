"""A model of waves, and campaigns of it, which take milliseconds."""

import numpy as np

import solvers
import structid as si

RECORD = si.GroundMotion(np.sin(np.arange(300) * 0.05), 0.01, "sine")
SHORT = si.GroundMotion(np.cos(np.arange(200) * 0.05), 0.02, "cosine")
SPACE = si.ParameterSpace(a=si.Uniform(0.0, 1.0), b=si.Normal(5.0, 1.0, low=1.0, unit="Hz"))


def wave_model(function=solvers.wave, **settings):
    return si.CallableModel(function, SPACE.names, ("velocity",), **settings)
