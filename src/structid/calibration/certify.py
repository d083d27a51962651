"""Anybody's posterior against the user's own model: draws that another program made, judged by a few true runs."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import scipy

from structid.calibration.density_of_draws import DensityOfDraws
from structid.calibration.drawn_laws import DrawnLaw
from structid.calibration.fitted_to_draws import FittedToDraws, ValuesAtDraws
from structid.calibration.foreign_draws import Draws, density_with, draws_of
from structid.calibration.true_runs import Tell, TrueRuns, noise_doubts
from structid.errors import InputError, names_checked
from structid.inference.assessment.certificate import FEWEST_DRAWS, Certificate, Limits, judged
from structid.inference.assessment.fresh_draws import FreshDraws, StoredRuns
from structid.inference.likelihood.posterior import Posterior
from structid.inference.target import Target
from structid.streams import Purpose, stream

Density = Callable[[np.ndarray], np.ndarray] | np.ndarray
"""Log density of the draws' law, up to a constant: a function of points (point, parameter) in SI, or its values at the draws."""


@names_checked
def certify(
    posterior: Target,
    draws: Draws,
    log_density: Density | None = None,
    *,
    true_runs: int | None = None,
    known: tuple[np.ndarray, np.ndarray] | None = None,
    limits: Limits | None = None,
    look: int = 1,
    seed: int = 0,
    store: str | os.PathLike[str] | None = None,
    executor: Any = None,
    progress: Tell | None = None,
) -> Certificate:
    """Certify a posterior that another program drew: by true runs at a few of its draws.

    The draws are said to come from a density q. The true posterior π is evaluated at some of them and, where q is a function, at
    draws of a wider law. The variation χ of π/q bounds how far every mean, standard deviation and probability may be off; see
    `Certificate`. Where q is a function, it is explored a second time, to see whether the draws are its own.

    Parameters
    ----------
    posterior : Posterior or LogDensity
        π, on the user's own model.
    draws : array, mapping, ArviZ object, path, or SamplingResult
        Draws (draw, parameter) or (chain, draw, parameter) in SI of all parameters of the posterior, those of the errors
        included; columns by name; an InferenceData, DataTree or Dataset; a netCDF or CSV file; or a result of `sample`.
    log_density : callable or ndarray, optional
        log q up to a constant, with respect to the parameters in SI: a function ``(point, parameter) -> (point,)``, or the values
        at the draws, shaped as these without the last axis. If it is left out, that of a `SamplingResult` is taken, or the variable
        ``log_density`` of the group ``sample_stats`` of a netCDF file. For other draws a density is fitted, and it is what is
        certified.
    true_runs : int, optional
        True runs to spend, and one more to run a point twice: 30 when left out, and 60 for a fitted density, which is worst in
        the tails.
    known : tuple of ndarray, optional
        Points (point, parameter) where log π (point,) is known already. None of them may exceed the draws.
    limits : Limits, optional
        What must be met.
    look : int
        1 for the first certificate of these draws, 2 for a repetition after a refusal, and so on: the confidence is divided.
    seed : int
        Chooses the draws.
    store : path-like, optional
        A folder for the true runs; a killed certificate goes on from there.
    executor : optional
        Where an external model's runs are done; see `Campaign.run`.
    progress : callable, optional
        Called with what is being done, how much of it is done, and the total.

    Returns
    -------
    Certificate
        The verdict and its figures.

    Raises
    ------
    InputError
        If these are draws of other parameters, too few, outside the support of the priors, or not of this density.
    """
    if true_runs is not None and true_runs < FEWEST_DRAWS:
        raise InputError("certify(true_runs)", f"{true_runs}", f"{FEWEST_DRAWS} or more, best 30 or more")
    limits = Limits() if limits is None else limits
    taken = draws_of(draws, posterior.names)
    log_density = density_with(draws) if log_density is None else log_density
    rng = stream(seed, Purpose.CERTIFIED_DRAWS)
    law = _law(posterior, taken, log_density, rng)
    points = np.empty((0, posterior.dimension)) if known is None else np.asarray(known[0], dtype=np.float64)
    doubts = law.doubts(points, seed)
    chosen = law.chosen(law.enough if true_runs is None else true_runs, rng)
    truth = _Truth(posterior, chosen.theta, None if store is None else Path(store), executor, progress)
    inside = np.isfinite(chosen.log_drawn)
    fresh = FreshDraws(
        chosen.theta[inside], truth.log_density[inside], chosen.log_drawn[inside], chosen.shares[inside], law.population,
        law.highest, truth.impossible[inside],
    )  # fmt: skip
    runs = (fresh.log_true, fresh.log_drawn)
    if known is not None:
        runs = np.concatenate([runs[0], known[1]]), np.concatenate([runs[1], law.log_density(points)])
    stored = _within_reach(*runs, limits)
    # Where q has no density at all, a run is no draw of it; it may show that something is there.
    doubts = (*doubts, *truth.doubts, *_cut_off(truth.log_density, inside, posterior.dimension, limits))
    found = judged(fresh, stored, posterior.names, len(chosen.theta) + 1, look, limits, doubts)
    return replace(found, subject=law.subject)


def _within_reach(log_true: np.ndarray, log_drawn: np.ndarray, limits: Limits) -> StoredRuns:
    """Known points near the best. Further away an approximation may be as wrong as it likes: it is no fit to what is there."""
    if not np.isfinite(log_true).any():
        return StoredRuns()
    near = np.isfinite(log_true) & (log_true >= log_true.max() - limits.reach)
    return StoredRuns(log_true[near], log_drawn[near])


def _cut_off(log_true: np.ndarray, inside: np.ndarray, dimension: int, limits: Limits) -> tuple[str, ...]:
    """Say where q ends although π is still high.

    If a share δ of π is missing and the rest is right, dq/dπ = 1/(1 − δ) in the support of q, so that means are shifted by
    √(δ/(1 − δ)) standard deviations at most. Of a normal law that is cut off h nats below its highest density, δ = P(χ²_d > 2h) is
    missing.
    """
    if inside.all() or not np.isfinite(log_true[inside]).any():
        return ()
    depth = float(log_true[inside].max() - log_true[~inside].max())
    missing = float(scipy.stats.chi2.sf(2.0 * max(depth, 0.0), dimension))
    if missing <= limits.mean**2 / (1.0 + limits.mean**2):
        return ()
    return (
        f"the given density ends where the posterior is still high: at a point that it excludes, the log density of the model is "
        f"{depth:.2g} nats below the highest. Of a normal law that ends there {missing:.0%} would be missing",
    )


def _law(posterior: Target, draws: np.ndarray, log_density: Density | None, rng: np.random.Generator) -> DrawnLaw:
    if log_density is None:
        return FittedToDraws(posterior, draws, rng)
    if callable(log_density):
        return DensityOfDraws(posterior, draws, log_density, rng)
    return ValuesAtDraws(posterior, draws, log_density, rng)


class _Truth:
    """The true posterior at some points, and at the first of them once more."""

    def __init__(
        self, posterior: Target, theta: np.ndarray, folder: Path | None, executor: Any, tell: Tell | None
    ) -> None:
        twice = np.concatenate([theta, theta[:1]])
        self.impossible = np.zeros(len(theta), dtype=bool)
        if isinstance(posterior, Posterior):
            points = np.asarray(posterior.model_parameters(twice))
            runs = TrueRuns(posterior, points, folder, executor, tell)
            runs.make()
            runs.refuse_rest()
            self.both = posterior.given(runs.responses()).log_density(twice)
            self.impossible = runs.collapsed(slice(len(theta)))
        else:
            self.both = np.asarray(posterior.log_density(twice))

    @property
    def log_density(self) -> np.ndarray:
        """Log π at the points, −inf where a run failed."""
        return np.where(np.isfinite(self.both[:-1]), self.both[:-1], -np.inf)

    @property
    def doubts(self) -> tuple[str, ...]:
        """That the same point, run twice, has two densities."""
        return noise_doubts(self.both[0], self.both[-1])
