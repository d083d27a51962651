"""A model of somebody else's: a linear oscillator by its exact recursion, in NumPy, many runs a call."""

import numpy as np

from structid.core.errors import InputError
from structid.core.hashing import digest
from structid.core.keys import quantity
from structid.histories import Histories
from structid.models.base import Model
from structid.models.model_kind import ModelKind


class LinearOscillator(Model):
    """u″ + 2ζω u′ + ω² u = −a_g, by central differences."""

    batched = True

    def __init__(self, frequency=None, damping_ratio=0.05, free=(), channels=("displacement",)):
        if channels != ("displacement",):
            raise InputError("LinearOscillator.channels", f"{channels}", "displacement")
        self.frequency, self.damping_ratio, self.free, self.channels = frequency, damping_ratio, tuple(free), channels

    def run(self, theta, excitation, progress=None, map=None):
        values = {"frequency": self.frequency, "damping_ratio": self.damping_ratio}
        values |= {name: theta[:, i] for i, name in enumerate(self.free)}
        omega, dt = 2.0 * np.pi * np.asarray(values["frequency"]), excitation.dt
        damping = 2.0 * np.asarray(values["damping_ratio"]) * omega
        u = np.zeros((len(theta), len(excitation)))
        for t in range(1, len(excitation) - 1):
            rhs = (
                -excitation.values[t]
                - omega**2 * u[:, t]
                + (2 * u[:, t] - (1 - damping * dt / 2) * u[:, t - 1]) / dt**2
            )
            u[:, t + 1] = rhs / ((1 + damping * dt / 2) / dt**2)
        return Histories(u[:, :, None], dt, self.channels, excitation=excitation.name, units=self.channel_units)

    @property
    def content_hash(self):
        return digest("LinearOscillator", self.frequency, self.damping_ratio, self.free)


KIND = ModelKind(
    word="linear_oscillator",
    keys={"frequency": (quantity("Hz"), None), "damping_ratio": (float, None)},
    build=lambda asked: LinearOscillator(free=asked.free, channels=asked.channels, **asked.given),
    parameters=lambda given: ("frequency", "damping_ratio"),
    parameter_unit=lambda name, given, unknown: {"frequency": "Hz", "damping_ratio": ""}.get(name),
)
