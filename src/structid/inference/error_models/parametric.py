"""Error models whose parameters are known, or have a prior, or have a default prior, for each channel."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Float

from structid.core.errors import InputError
from structid.core.units import squared
from structid.inference.error_models.base import Discrepancy
from structid.probability.marginals import Uniform
from structid.probability.truncation import Marginal

VARIANCES = ("variance", "white")
"""Parameters that are variances; their default prior is U(0, max|y|²)."""


class Parametric(Discrepancy):
    """Common part: every parameter is a field that holds a number, a prior, or None for the default prior."""

    kind: ClassVar[str]

    @classmethod
    @abstractmethod
    def _names(cls) -> tuple[str, ...]:
        """Names of all parameters, which are fields."""

    @abstractmethod
    def _default_prior(self, name: str, dt: float, samples: int) -> Marginal:
        """Default prior of a parameter that is not a variance."""

    def __post_init__(self) -> None:
        for name in self._names():
            value = getattr(self, name)
            least = 0.0 if name == "white" else np.nextafter(0.0, 1.0)
            if isinstance(value, (int, float)) and not (np.isfinite(value) and value >= least):
                raise InputError(f"{type(self).__name__}({name})", f"{value}", "a positive number, a prior, or None")

    def parameters(
        self, values: Float[np.ndarray, "time channel"], channels: tuple[str, ...], dt: float, units: tuple[str, ...]
    ) -> dict[str, Marginal]:
        """Unknown parameters and their priors; see `Discrepancy.parameters`."""
        priors: dict[str, Marginal] = {}
        for i, (channel, unit) in enumerate(zip(channels, units, strict=True)):
            peak = float(np.abs(values[:, i]).max())
            if peak == 0.0:
                raise InputError(f"observation, channel '{channel}'", "zero throughout", "a varying response")
            for name in self._names():
                given = getattr(self, name)
                if isinstance(given, (int, float)):
                    continue
                default = (
                    Uniform(0.0, peak**2, unit=squared(unit))
                    if name in VARIANCES
                    else self._default_prior(name, dt, len(values))
                )
                priors[_name(name, channel, channels)] = default if given is None else given
        return priors

    def _values(self, unknown: Mapping[str, Any], channels: tuple[str, ...], runs: int, numpy: Any) -> dict[str, Any]:
        """Every parameter as an array (channel, run)."""
        values = {}
        for name in self._names():
            given = getattr(self, name)
            rows = [
                given if isinstance(given, (int, float)) else unknown[_name(name, channel, channels)]
                for channel in channels
            ]
            values[name] = numpy.stack([numpy.broadcast_to(numpy.asarray(r, dtype=np.float64), (runs,)) for r in rows])
        return values

    def describe(self) -> dict[str, Any]:
        """Return the kind and the arguments."""
        description: dict[str, Any] = {"kind": self.kind}
        for name in self._names():
            value = getattr(self, name)
            description[name] = value.describe() if isinstance(value, Marginal) else value
        return description


def _name(parameter: str, channel: str, channels: tuple[str, ...]) -> str:
    """Name of an error-model parameter in a posterior."""
    plain = {"variance": "sigma2", "white": "sigma2_white"}.get(parameter, parameter)
    return f"{plain}_{channel}" if len(channels) > 1 else plain
