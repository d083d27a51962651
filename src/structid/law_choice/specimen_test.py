"""A test of a specimen, as the choice of a hysteretic law uses it: what sensors show, and default priors for it."""

from __future__ import annotations

import itertools
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Sequence
from functools import cached_property
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np
from jaxtyping import Float, Int

from structid.core.notebook import ShownAsText
from structid.inference.error_models.base import ErrorModel
from structid.inference.error_models.independent import IID
from structid.inference.likelihood.posterior import Posterior
from structid.mechanics.hysteretic_laws.base import HystereticLaw, LawParameter
from structid.mechanics.hysteretic_laws.default_priors import scaled
from structid.models.hysteretic.hysteretic import Hysteretic
from structid.observation import Observation
from structid.probability.space import ParameterSpace
from structid.probability.truncation import Marginal

Residuals = Callable[[Float[np.ndarray, "run parameter"]], Float[np.ndarray, "run value"]]
"""Measured minus modelled values of all sensors in SI, not finite for a run that failed."""


class SensorValues(NamedTuple):
    """Measured values of one sensor, whose errors have one variance and one correlation."""

    values: Float[np.ndarray, " value"]  # in SI
    gaps: Int[np.ndarray, " interval"]  # samples from each value to the next; more than one if values are missing

    @property
    def largest(self) -> float:
        """Largest absolute value in SI."""
        return float(np.abs(self.values).max())


class SpecimenTest(ShownAsText, ABC):
    """A test that shows the hysteretic law of a specimen."""

    name: str
    quantity: ClassVar[str]
    """What the sensors show, in words."""
    course: ClassVar[str]
    """What the test consists of, in words."""

    @property
    @abstractmethod
    def sensors(self) -> tuple[SensorValues, ...]:
        """Measured values of every sensor."""

    @property
    @abstractmethod
    def observations(self) -> tuple[Observation, ...]:
        """The measurements; each has one sensor."""

    @property
    @abstractmethod
    def initial_stiffness(self) -> float:
        """Scale of the initial stiffness [N/m]."""

    @property
    @abstractmethod
    def largest_force(self) -> float:
        """Scale of the force [N]."""

    @property
    @abstractmethod
    def largest_displacement(self) -> float:
        """Scale of the displacement [m]."""

    @property
    @abstractmethod
    def content_hash(self) -> str:
        """Hash of all data and settings of the test."""

    @abstractmethod
    def model(self, law: HystereticLaw, free: Sequence[str]) -> Hysteretic:
        """Return the model of the test with some parameters free."""

    @abstractmethod
    def priors(self, law: HystereticLaw, known: Collection[str] = ()) -> ParameterSpace:
        """Return priors of the unknown parameters of the model, without those that keep the law's value."""

    @abstractmethod
    def residuals(self, law: HystereticLaw, space: ParameterSpace, finer: int = 1) -> Residuals:
        """Return the residuals as a function of the parameters of a space, in shorter steps if wanted."""

    @property
    @abstractmethod
    def searched(self) -> Self:
        """A test with fewer values, on which a law is searched."""

    @property
    @abstractmethod
    def first(self) -> Self | None:
        """The first part of the test, from which the rest is predicted; None if the test cannot be divided."""

    def default_prior(self, described: LawParameter) -> Marginal:
        """Return the default prior of a parameter that has one, in the scales of the test, in kN and mm."""
        scales = {
            "N/m": (1e-6 * self.initial_stiffness, "kN/mm"),
            "N": (1e-3 * self.largest_force, "kN"),
            "m": (1e3 * self.largest_displacement, "mm"),
            "": (1.0, ""),
        }
        assert described.prior is not None
        return scaled(described.prior, *scales[described.unit])

    def unknowns(self, law: HystereticLaw, known: Collection[str] = ()) -> ParameterSpace:
        """Return priors of the model's parameters and of the sensors' parameters, without those of the errors."""
        key = law, tuple(known)
        if key not in self._unknowns:
            posterior = self.posterior(law, known)
            of_errors = posterior.likelihood.discrepancy_names
            marginals = {n: prior for n, prior in posterior.space.marginals.items() if n not in of_errors}
            self._unknowns[key] = ParameterSpace(marginals)
        return self._unknowns[key]

    @cached_property
    def _unknowns(self) -> dict[tuple[HystereticLaw, tuple[str, ...]], ParameterSpace]:
        """The priors of `unknowns`."""
        return {}

    def posterior(self, law: HystereticLaw, known: Collection[str] = (), errors: ErrorModel | None = None) -> Posterior:
        """Return the posterior of the parameters of a law, with independent errors by default."""
        space = self.priors(law, known)
        return Posterior(space, self.model(law, space.names), self.observations, discrepancy=errors or IID())

    @cached_property
    def blocks(self) -> tuple[slice, ...]:
        """Where each sensor's values are among all values."""
        ends = np.cumsum([0, *(len(sensor.values) for sensor in self.sensors)])
        return tuple(slice(int(a), int(b)) for a, b in itertools.pairwise(ends))

    @cached_property
    def scales(self) -> Float[np.ndarray, " value"]:
        """Largest absolute value of the sensor of each value."""
        return np.concatenate([np.full(len(s.values), s.largest) for s in self.sensors])

    def unexplained(self, residuals: Float[np.ndarray, " value"]) -> float:
        """Return the part of the variance that a model leaves unexplained, Σ r²/Σ (y − ȳ)²; the mean of several sensors.

        Parameters
        ----------
        residuals : ndarray, shape (value,)
            Measured minus modelled values of all sensors.

        Returns
        -------
        float
            Residual variance over the variance of the measured values.
        """
        shares = [
            np.sum(residuals[b] ** 2) / _variation(s.values) for s, b in zip(self.sensors, self.blocks, strict=True)
        ]
        return float(np.mean(shares))

    def relative_error(self, residuals: Float[np.ndarray, " value"], after: Self) -> float:
        """Return the root mean square of the residuals after a first part, relative to the largest values."""
        later = [
            residuals[block][len(part.values) :] / sensor.largest
            for sensor, part, block in zip(self.sensors, after.sensors, self.blocks, strict=True)
        ]
        return float(np.sqrt(np.mean(np.concatenate(later) ** 2)))


def _variation(values: Float[np.ndarray, " value"]) -> Any:
    return np.sum((values - values.mean()) ** 2)
