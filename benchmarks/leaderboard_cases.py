"""Posteriors of the leaderboard: response models with a measurement, and their log densities for other programs.

The error variance is integrated out of the log densities, so that the other programs have the same few parameters.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy
from calibration import degrading, el_centro, measured, model_and_space, stochastic

import structid as si


@dataclass(frozen=True, eq=False)
class Case:
    """One posterior.

    Parameters
    ----------
    name : str
        Name in the table.
    model : Model
        Model to be calibrated.
    space : ParameterSpace
        Its priors.
    observation : Observation
        Measurement.
    respond : callable
        Function that returns responses (run, time) for parameters (run, parameter) in one call.
    variance : float or None
        Error variance, if it is known.
    """

    name: str
    model: Any
    space: si.ParameterSpace
    observation: si.Observation
    respond: Callable[[np.ndarray], np.ndarray]
    variance: float | None = None

    @property
    def law(self) -> Any:
        """Error model for `calibrate`."""
        return None if self.variance is None else si.IID(variance=self.variance)

    def log_density(self, theta: np.ndarray) -> np.ndarray:
        """Log prior plus log-likelihood; an unknown variance is integrated over U(0, max y²)."""
        theta = np.atleast_2d(theta)
        density = np.full(len(theta), -np.inf)
        inside = np.isfinite(self.space.log_density(theta))
        if inside.any():
            y = self.observation.values[:, 0]
            squares = np.sum((self.respond(theta[inside]) - y) ** 2, axis=1)
            if self.variance is not None:
                likelihood = -0.5 * squares / self.variance
            else:
                # ∫₀^V s^(−n/2) exp(−S/2s) ds = Γ(n/2 − 1, S/2V) (S/2)^(1 − n/2)
                power = 0.5 * len(y) - 1.0
                tail = scipy.special.gammaincc(power, 0.5 * squares / np.max(y**2))
                likelihood = np.log(np.maximum(tail, 1e-300)) - power * np.log(squares)
            found = self.space.log_density(theta[inside]) + likelihood
            density[inside] = np.where(np.isfinite(found), found, -np.inf)
        return density

    @cached_property
    def target(self) -> si.LogDensity:
        """The log density as a target for samplers and `certify`."""
        bounds = {name: tuple(pair) for name, pair in zip(self.space.names, self.space.bounds, strict=True)}
        return si.LogDensity(self.log_density, self.space.names, self.space, bounds)


def study(name: str, record: si.GroundMotion) -> Case:
    """The packaged study on a record: four parameters of an oscillator without degradation."""
    model, space = model_and_space()
    return Case(name, model, space, measured(record), lambda theta: model.simulate(theta, record).values[..., 0])


def seven_parameters() -> Case:
    """Seven parameters of the model class that generated the data."""
    model, space, observation = degrading()
    record = observation.record
    return Case(
        "seven parameters, degrading",
        model,
        space,
        observation,
        lambda theta: model.simulate(theta, record).values[..., 0],
    )


def of_a_formula(
    name: str, space: si.ParameterSpace, respond: Callable[[np.ndarray], np.ndarray], y: np.ndarray, variance: float
) -> Case:
    """Case whose response is a formula; every call of the model counts as a model run."""
    record = si.GroundMotion(np.sin(np.arange(len(y))), 0.1, name=name)

    def one(parameters: Any, _record: Any) -> np.ndarray:
        return respond(np.array([[parameters[n] for n in space.names]]))[0]

    model = si.CallableModel(one, free=space.names, channels=("velocity",), isolated=False)
    return Case(name, model, space, si.Observation(record, y), respond, variance)


def directions(count: int, length: int = 40) -> np.ndarray:
    """Return orthonormal histories, shape (history, time)."""
    return np.linalg.qr(np.random.default_rng(4).standard_normal((length, count)))[0].T


def rosenbrock() -> Case:
    """Log-likelihood −(1 − a)² − 100 (b − a²)², with priors N(0, 3) as in PyVBMC's first example."""
    first, second = directions(2)
    space = si.ParameterSpace(a=si.Normal(0.0, 3.0), b=si.Normal(0.0, 3.0))

    def respond(theta: np.ndarray) -> np.ndarray:
        a, b = theta[:, :1], theta[:, 1:]
        return a * first + 10.0 * (b - a**2) * second

    return of_a_formula("Rosenbrock, two parameters", space, respond, first, 0.5)


def two_modes() -> Case:
    """Modes at a = 1 and a = −1.2, where a² + 0.2 a = 1.2; the prior gives the first mode more weight."""
    histories = directions(3)
    space = si.ParameterSpace(a=si.Normal(0.5, 1.0), b=si.Normal(0.0, 1.0), c=si.Normal(0.0, 1.0))

    def respond(theta: np.ndarray) -> np.ndarray:
        seen = np.stack([theta[:, 0] ** 2 + 0.2 * theta[:, 0], theta[:, 1], theta[:, 2] + 0.5 * theta[:, 1] ** 2])
        return seen.T @ histories

    y = np.array([1.2, 0.3, -0.4]) @ histories
    return of_a_formula("two modes, three parameters", space, respond, y, 0.15**2)


CASES: dict[str, Callable[[], Case]] = {
    "stochastic": lambda: study("study, stochastic record", stochastic(1.8)),
    "el_centro": lambda: study("study, El Centro 1.8 m/s²", el_centro(1.8)),
    "el_centro_strong": lambda: study("study, El Centro 3.59 m/s²", el_centro(3.59)),
    "degrading": seven_parameters,
    "rosenbrock": rosenbrock,
    "two_modes": two_modes,
}
"""Cases by their name on the command line."""
