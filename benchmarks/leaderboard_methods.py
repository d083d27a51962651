"""The programs of the leaderboard with their defaults: their draws, claims and costs."""

from __future__ import annotations

import importlib.util
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from leaderboard_cases import Case

import structid as si

DRAWS = 8000
PLAUSIBLE = (0.1, 0.9)
"""Quantiles of the priors that bound PyVBMC's plausible region."""
BOX = (1e-5, 1.0 - 1e-5)
"""Quantiles of the priors that bound GPry's search."""
MOST_INITIAL = 500
"""Largest number of runs for GPry's first finite points; with its default of 84 to 160 it stops on narrow posteriors."""
WALKERS, MOST_STEPS, TIMES = 32, 20_000, 50.0
"""emcee: walkers, largest number of steps, and autocorrelation times that its authors require for convergence."""


@dataclass(frozen=True, eq=False)
class Outcome:
    """Outcome of a program.

    Parameters
    ----------
    draws : ndarray, shape (draw, parameter)
        Draws of the case's parameters, in SI units.
    claims : bool
        Whether the program reports convergence or a certificate.
    runs, rounds : int
        Number of model runs, and number of successive rounds.
    log_density : callable or None
        Log density of the draws, if the program provides it.
    known : tuple of ndarray or None
        Points of the model runs, and their log densities.
    """

    draws: np.ndarray
    claims: bool
    runs: int
    rounds: int
    log_density: Callable[[np.ndarray], np.ndarray] | None = None
    known: tuple[np.ndarray, np.ndarray] | None = None


class Counted:
    """Log density of one point that stores all evaluated points."""

    def __init__(self, case: Case) -> None:
        self.case = case
        self.points: list[np.ndarray] = []
        self.values: list[float] = []

    def __call__(self, x: Any) -> float:
        """Log density of one point."""
        point = np.asarray(x, dtype=np.float64).ravel()
        self.points.append(point)
        self.values.append(float(self.case.log_density(point[None])[0]))
        return self.values[-1]

    @property
    def known(self) -> tuple[np.ndarray, np.ndarray]:
        """Points and log densities."""
        return np.array(self.points), np.array(self.values)


def structid(case: Case, seed: int) -> Outcome:
    """`si.calibrate` with default settings."""
    result = si.calibrate(case.model, case.space, case.observation, discrepancy=case.law, seed=seed)
    dimension, certificate = case.space.dimension, result.certificate
    return Outcome(result.sampling.flat[:, :dimension], certificate.certified, certificate.true_runs, result.depth)


def pyvbmc(case: Case, seed: int) -> Outcome:
    """Variational Bayesian Monte Carlo (Acerbi 2018), with plausible bounds at quantiles of the priors."""
    from pyvbmc import VBMC

    np.random.seed(seed)  # noqa: NPY002  # its own source of randomness
    dimension, density = case.space.dimension, Counted(case)
    lower, upper = np.array(case.space.bounds).T
    low, high = (case.space.quantile(np.full(dimension, p)[None])[0] for p in PLAUSIBLE)
    start = case.space.quantile(np.full((1, dimension), 0.5))[0]
    vbmc = VBMC(density, start[None], lower[None], upper[None], low[None], high[None], options={"display": "off"})
    found, results = vbmc.optimize()
    draws = found.sample(DRAWS)[0]

    def log_density(theta: np.ndarray) -> np.ndarray:
        return np.asarray(found.pdf(theta, log_flag=True)).ravel()

    return Outcome(
        draws,
        bool(results["success_flag"]),
        len(density.values),
        int(results["iterations"]),
        log_density,
        density.known,
    )


def gpry(case: Case, seed: int) -> Outcome:
    """Gaussian-process surrogate of the log posterior (Gammal et al. 2023), with bounds at quantiles of the priors."""
    from gpry import Runner

    dimension, density = case.space.dimension, Counted(case)
    box = np.stack([case.space.quantile(np.full((1, dimension), p))[0] for p in BOX], axis=1)
    # GPry's prior is uniform within the bounds; the log density includes the case's prior.
    runner = Runner(
        lambda x: density(x), box, seed=seed, verbose=0, plots=False, options={"max_initial": MOST_INITIAL}
    )  # GPry inspects the signature
    runner.run()
    runner.generate_mc_sample()
    sample = runner.last_mc_samples()
    weights = np.asarray(sample["w"], dtype=np.float64)
    rows = np.random.default_rng(seed).choice(len(weights), size=DRAWS, p=weights / weights.sum())
    draws = np.asarray(sample["X"])[rows]
    surrogate = runner.surrogate

    def log_density(theta: np.ndarray) -> np.ndarray:
        inside = ((theta >= box[:, 0]) & (theta <= box[:, 1])).all(axis=1)
        values = np.full(len(theta), -np.inf)
        if inside.any():
            values[inside] = surrogate.predict(theta[inside])
        return values

    rounds = int(getattr(runner, "current_iteration", 0)) or len(density.values)
    return Outcome(draws, bool(runner.has_converged), len(density.values), rounds, log_density, density.known)


def emcee(case: Case, seed: int) -> Outcome:
    """Affine-invariant ensemble on the model itself, until its convergence rule is met or 640 000 runs are spent."""
    from emcee import EnsembleSampler

    rng = np.random.default_rng(seed)
    start = case.space.sample(WALKERS, seed).values
    sampler = EnsembleSampler(WALKERS, case.space.dimension, case.log_density, vectorize=True)
    sampler._random = np.random.RandomState(rng.integers(2**31))  # its own source of randomness
    claims, state = False, start
    while sampler.iteration < MOST_STEPS and not claims:
        state = sampler.run_mcmc(state, 1000)
        times = sampler.get_autocorr_time(tol=0)
        claims = bool(np.all(sampler.iteration > TIMES * times))
    discard = sampler.iteration // 2
    return Outcome(
        sampler.get_chain(discard=discard, flat=True), claims, WALKERS * sampler.iteration, 2 * sampler.iteration
    )


METHODS: dict[str, Callable[[Case, int], Outcome]] = {
    "structid": structid,
    "PyVBMC": pyvbmc,
    "GPry": gpry,
    "emcee": emcee,
}


def installed(method: str) -> bool:
    """Whether a program is installed; the other programs are a separate dependency group."""
    return method == "structid" or importlib.util.find_spec(method.lower()) is not None


def quiet() -> None:
    """Suppress the many warnings of the other programs."""
    warnings.simplefilter("ignore")
