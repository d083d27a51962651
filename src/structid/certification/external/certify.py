"""Certification of external draws against the user's own model, by a few model runs."""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from structid.certification.certificate import FEWEST_DRAWS, Certificate, issue_certificate
from structid.certification.external.drawn_density import Chosen, DrawnDensity
from structid.certification.external.draws_with_density import DensityOfDraws
from structid.certification.external.draws_without_density import FittedToDraws, ValuesAtDraws
from structid.certification.external.external_draws import Draws, density_with, draws_of
from structid.certification.external.hidden_modes import searched
from structid.certification.external.learnt_density import LearntDensity
from structid.certification.external.truncated_support import with_what_is_excluded
from structid.certification.fresh_draws import FreshDraws, StoredRuns
from structid.certification.known_points import Points, joined
from structid.certification.limits import Limits
from structid.certification.model_runs import NOISE, ReportActivity
from structid.certification.monte_carlo_error import MonteCarloError
from structid.certification.true_posterior import Truth
from structid.core.errors import InputError
from structid.core.streams import Purpose, stream
from structid.core.validation import check_arguments, real_array
from structid.inference.target import Target

Density = Callable[[np.ndarray], np.ndarray] | np.ndarray
"""Log density of the draws up to a constant: a function of points (point, parameter) in SI, or its values at the draws."""

SEARCH_SHARE = 6
"""Number of runs at draws for each further run that searches for a missed mode."""
AT_ONCE = 10
"""Number of model runs in each round that trains the correction."""


@check_arguments
def certify(
    posterior: Target,
    draws: Draws,
    log_density: Density | None = None,
    *,
    true_runs: int | None = None,
    searches: int | None = None,
    teaching: int | None = None,
    known: tuple[np.ndarray, np.ndarray] | None = None,
    limits: Limits | None = None,
    look: int = 1,
    seed: int = 0,
    store: str | os.PathLike[str] | None = None,
    executor: Any = None,
    progress: ReportActivity | None = None,
) -> Certificate:
    """Certify a posterior that another program sampled, from model runs at a few of its draws.

    The draws should follow a density q. The true posterior π is evaluated at some draws and, if q is a function, at draws from a
    wider density. The variation χ of π/q bounds the error of every mean, standard deviation and probability; see `Certificate`.
    If q is a function, a second sampler checks whether the draws follow q. Averages over the draws also have a Monte Carlo error,
    which depends on the number and autocorrelation of the draws. The statement includes this error, and draws that are too few
    for the limits are refused.

    Parameters
    ----------
    posterior : Posterior or LogDensity
        The true posterior π, with the user's own model.
    draws : array, mapping, ArviZ object, path, or SamplingResult
        Draws (draw, parameter) or (chain, draw, parameter) in SI of all parameters of the posterior, including the error
        model's; columns by name; an InferenceData, DataTree or Dataset; a netCDF or CSV file; or a result of `sample`.
    log_density : callable or ndarray, optional
        log q up to a constant, with respect to the parameters in SI: a function ``(point, parameter) -> (point,)``, or the values
        at the draws, with their shape without the last axis. By default, the log density of a `SamplingResult` is used, or the
        variable ``log_density`` of the group ``sample_stats`` of a netCDF file. For other draws, a density is fitted and certified
        instead.
    true_runs : int, optional
        Number of model runs at draws; one more run repeats a point. By default 30, or 60 for a fitted density, which is least
        accurate in the tails.
    searches : int, optional
        Largest number of further model runs, in rounds of three, that search for missed modes. By default a sixth of `true_runs`,
        or twice as many once a run comes close to a relevant density. They need a posterior with a separate prior.
    teaching : int, optional
        Largest number of further model runs, in rounds of ten, if the draws are inconclusive, at the points that are
        most informative about the draws' density. By default half of `true_runs`.
    known : tuple of ndarray, optional
        Points (point, parameter) in SI with known log π (point,), as computed by the posterior. One model run at the best of
        these points checks the values. A known point whose density clearly exceeds that of all draws prevents a certificate. The
        points guide the search for missed modes and the correction of the draws' density.
    limits : Limits, optional
        Limits that the certificate must meet.
    look : int
        Number of the attempt: 1 for the first certificate of these draws, 2 after a refusal, and so on. The error probability is
        divided among all attempts. The draws alone, and the correction after every round of further runs, are separate attempts.
    seed : int
        Seed for the choice of draws.
    store : path-like, optional
        Folder for the model runs; an interrupted certification continues from it.
    executor : optional
        Executor of an external model's runs; see `Campaign.run`.
    progress : callable, optional
        Called with the current activity, the amount done, and the total.

    Returns
    -------
    Certificate
        The verdict, with its bounds and reasons.

    Raises
    ------
    InputError
        If the draws are too few, lack parameters, lie outside the support of the priors or contradict `log_density`, or
        if the model gives another log density at a known point.

    Examples
    --------
    >>> import scipy.stats
    >>> import structid as si
    >>> log_density = lambda x: -0.5 * (x**2).sum(axis=-1)
    >>> target = si.LogDensity(log_density, ("a", "b"), si.ParameterSpace(a=si.Normal(0.0, 3.0), b=si.Normal(0.0, 3.0)))
    >>> draws = scipy.stats.norm.rvs(size=(4000, 2), random_state=1)
    >>> si.certify(target, draws, log_density).certified
    True
    """
    if true_runs is not None and true_runs < FEWEST_DRAWS:
        raise InputError("certify(true_runs)", f"{true_runs}", f"{FEWEST_DRAWS} or more, 30 or more recommended")
    for word, count in (("searches", searches), ("teaching", teaching)):
        if count is not None and count < 0:
            raise InputError(f"certify({word})", f"{count}", "0 or more")
    limits = Limits() if limits is None else limits
    draws_taken = draws_of(draws, posterior.names, posterior.units)
    log_density = density_with(draws) if log_density is None else log_density
    rng = stream(seed, Purpose.CERTIFIED_DRAWS)
    drawn = _drawn_density(posterior, draws_taken, log_density, rng)
    known = _known(known, posterior.dimension)
    by_chance = MonteCarloError.of(posterior.compared(drawn.in_order(drawn.flat)), limits.confidence)
    doubts, of_draws = drawn.checked(known[0], by_chance, limits, seed)
    doubts = (*doubts, *by_chance.too_large(limits, posterior.compared_names))
    chosen = drawn.chosen(drawn.enough if true_runs is None else true_runs, rng)
    truth = Truth(posterior, None if store is None else Path(store), executor, progress)
    _compare_known(known, truth)
    log_true = truth.at(chosen.theta)
    noise = truth.twice()
    before = truth.count
    inside = np.isfinite(chosen.log_drawn)
    judges = chosen.inside
    fresh = FreshDraws(
        judges.theta,
        posterior.compared(judges.theta),
        log_true[inside],
        judges.log_drawn,
        judges.shares,
        posterior.compared(drawn.population),
        drawn.highest,
        truth.impossible[-len(chosen.theta) :][inside],
    )
    others = known
    if posterior.knows_prior and np.isfinite(log_true).any():
        count = len(chosen.theta) // SEARCH_SHARE if searches is None else searches
        at_draws = fresh.theta, fresh.log_true
        others = joined(known, searched(drawn, at_draws, known, fresh.middle, count, truth.at, limits, rng))
    # A run where q is zero is not a draw of q; it may reveal density there.
    fresh, why = with_what_is_excluded(drawn, fresh, joined((chosen.theta, log_true), others), truth.at, limits)
    searching = truth.count - before
    more = len(chosen.theta) // 2 if teaching is None else teaching
    far = drawn.far_from_prior(stream(seed, Purpose.PRIOR_BESIDE_DRAWS))
    certificate = _judged(drawn, judges, fresh, others, truth, more, look, limits, doubts, (*far, *noise, *why), rng)
    return replace(certificate, subject=drawn.subject, searched=searching, monte_carlo=of_draws)


def _judged(
    drawn: DrawnDensity,
    judges: Chosen,
    fresh: FreshDraws,
    others: Points,
    truth: Truth,
    teaching: int,
    look: int,
    limits: Limits,
    doubts: tuple[str, ...],
    against: tuple[str, ...],
    rng: np.random.Generator,
) -> Certificate:
    """Certify by the weights of the draws or, if inconclusive, by the correction after further training runs."""
    names, before = drawn.posterior.compared_names, truth.count
    near = _within_reach(drawn, fresh, others, limits)
    certificate = issue_certificate(fresh, near, names, before, 2 * look - 1, limits, doubts, against)
    if certificate.certified or doubts or against or not np.isfinite(fresh.log_true).all():
        return certificate
    # The draws alone use α/2^(2k−1), the corrections share α/2^2k: all attempts of all k are wrong with probability α at most.
    looks = itertools.count(2 * look + 1)
    for count in (*(min(AT_ONCE, teaching - done) for done in range(0, teaching, AT_ONCE)), 0):
        learnt = LearntDensity(drawn, judges, fresh, others, rng)
        near, correction = learnt.stored(limits), learnt.correction
        again = issue_certificate(
            learnt.judging(), near, names, before, next(looks), limits, (), learnt.doubts, correction
        )
        if again.certified or again.mean_bound.max() < certificate.mean_bound.max():
            certificate = again
        if again.certified or count == 0 or correction.beyond(limits):
            break
        theta = learnt.worth_teaching(count)
        others = joined(others, (theta, truth.at(theta)))
    return replace(certificate, true_runs=truth.count, taught=truth.count - before)


def _known(known: Points | None, dimension: int) -> Points:
    """Check runs supplied by the user."""
    if known is None:
        return np.empty((0, dimension)), np.empty(0)
    theta, log_true = (real_array("certify(known)", part) for part in known)
    if theta.ndim != 2 or theta.shape[1] != dimension or log_true.shape != (len(theta),):
        raise InputError(
            "certify(known)",
            f"points of shape {theta.shape} with log densities of shape {log_true.shape}",
            f"(point, {dimension}) in SI and (point,), the log densities as the posterior computes them",
        )
    ran = np.isfinite(theta).all(axis=1) & ~np.isnan(log_true)
    return theta[ran], log_true[ran]


def _compare_known(known: Points, truth: Truth) -> None:
    """Run the model at the best supplied point, since log densities that lack a constant would mislead."""
    theta, log_true = known
    if not np.isfinite(log_true).any():
        return
    best = int(np.argmax(log_true))
    log_density_there = float(truth.at(theta[best : best + 1])[0])
    if not abs(log_density_there - log_true[best]) <= NOISE:
        raise InputError(
            "certify(known)",
            f"a log density of {log_true[best]:.6g} at the best of {len(theta)} points, where the posterior gives "
            f"{log_density_there:.6g}",
            "log π as `posterior.log_density` computes it",
            "Check for a missing prior, for constants that other programs omit, and for noise in the model.",
        )


def _within_reach(drawn: DrawnDensity, fresh: FreshDraws, others: Points, limits: Limits) -> StoredRuns:
    """Return the runs near the best run where q is positive; `with_what_is_excluded` checks those where it is zero."""
    log_true = np.concatenate([fresh.log_true, others[1]])
    log_drawn = np.concatenate([fresh.log_drawn, drawn.log_density(others[0]) if len(others[0]) else others[1]])
    near = np.isfinite(log_true) & np.isfinite(log_drawn) & (log_true >= log_true.max() - limits.reach)
    return StoredRuns(log_true[near], log_drawn[near])


def _drawn_density(
    posterior: Target, draws: np.ndarray, log_density: Density | None, rng: np.random.Generator
) -> DrawnDensity:
    if log_density is None:
        return FittedToDraws(posterior, draws, rng)
    if callable(log_density):
        return DensityOfDraws(posterior, draws, log_density, rng)
    return ValuesAtDraws(posterior, draws, log_density, rng)
