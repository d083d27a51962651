"""Certificate of a posterior that was not sampled with the model itself, from model runs at fresh draws.

The statement rests on one number, χ: the coefficient of variation of the weights w = π/q, with π the true posterior and q the
drawn density; see `weight_variation`. The certificate holds if an upper bound of χ, from a few fresh draws, is small enough for
every mean and every standard deviation. Draws from q cannot reveal probability of π where q is zero; the stored model runs of all
rounds are searched for it.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from typing import Any, Literal, NamedTuple

import numpy as np

from structid.certification.correction import Correction
from structid.certification.fresh_draws import FreshDraws, StoredRuns
from structid.certification.limits import Limits
from structid.certification.moment_bounds import (
    correlation_bound,
    mean_bound,
    missing_bounds,
    sd_bound,
    shift,
    standardised,
)
from structid.certification.monte_carlo_error import MonteCarloError
from structid.certification.weight_variation import WeightVariation, weight_variation
from structid.core.errors import InputError
from structid.core.notebook import ShownAsText
from structid.inference.convergence import weighted_size

CertificateVerdict = Literal["certified", "usable with re-weighting", "not to be trusted"]

FEWEST_DRAWS = 15
"""Minimum number of fresh draws, with which the bound on χ² is already about five times its estimate."""

NOTHING = 10.0
"""Largest bound that is reported as a number; a larger one is reported as "more than" this."""

STEIN = ", and since their averages differ from those of their density by the gradient of its values (Stein's identity)"
"""Second reason for an error of draws whose density is known only at them."""

RESTS_ON_STEIN = (
    "  the given values are those of the model itself: that the draws follow them rests on the gradient of these values "
    "alone"
)
"""Line on draws with the values of the true posterior."""

OWN = 1e-6
"""Coefficient of variation of the weights below which the given values are those of the model."""

MORE_DRAWS = (2, 3, 4, 6, 8, 12, 16, 24, 32)
"""Multiples of the number of fresh draws for which the bounds are computed after a refusal."""

UNSEEN = 3.0
"""The factor 3 in 3/n: with a probability of 5 %, none of n draws falls into a set of probability 3/n."""


@dataclass(frozen=True, eq=False)
class Certificate(ShownAsText):
    """Assessment of a posterior that was not sampled with the model itself, with its reasons.

    Parameters
    ----------
    verdict : {"certified", "usable with re-weighting", "not to be trusted"}
        Certified: use the draws as they are. Usable: use re-weighted moments and quantiles. Otherwise: do more model runs.
    reasons : tuple of str
        Limits and checks that were not met, one sentence each.
    doubts : tuple of str
        The reasons that concern only the draws: they have not converged, or a second sampler disagrees.
    variation : WeightVariation
        Estimate χ̂ of χ, and its bound U.
    mean_bound : ndarray, shape (parameter,)
        Bound on the error of each mean, in standard deviations: U, or less if the runs provide a correction.
    sd_bound : ndarray, shape (parameter,)
        Bound on the relative error of each standard deviation.
    correlation_bound : ndarray, shape (parameter, parameter)
        Bound on the error of the correlation of each pair of parameters.
    shift, shift_error : ndarray, shape (parameter,)
        Shift of each mean by the weights, in standard deviations, and the Monte Carlo error of this shift.
    draws : ndarray, shape (draw, parameter)
        The fresh draws, in SI.
    weights : ndarray, shape (draw,)
        Weights of the fresh draws in averages over the true posterior; they sum to one.
    log_ratios : ndarray, shape (draw,)
        log π/q of each fresh draw, up to a constant; −inf where a model run failed.
    look : int
        Number of the attempt: 1 for the first certificate, 2 for the certificate after a refusal, and so on.
    above : float
        Excess of the best stored model run's log density over the best draw's [nat].
    excess : float
        Largest log π/q, above the median over the draws, of the stored model runs within reach of the best run [nat].
    within_reach : int
        Number of stored model runs within reach of the best run.
    failed : int
        Number of fresh draws whose model run failed.
    true_runs : int
        Total number of model runs, including the runs for the certificate.
    limits : Limits
        Limits that the certificate must meet.
    names : tuple of str
        Parameters, or their logarithms; see `Target.compared`.
    correction : Correction or None
        Correction of q learnt from the runs, if the weights of the draws alone did not decide.
    subject : str
        Description of the certified density, if the draws themselves are not certified.
    searched, taught : int
        Numbers of model runs that searched for missed modes, and that corrected the draws' density.
    missing : float
        Fraction of the posterior that may lie where the draws' density is zero; the bounds allow for it.
    monte_carlo : MonteCarloError or None
        Monte Carlo error of the moments of external draws; the bounds above hold for the moments of their density. None for a
        calibration, whose draws have their own verdict.
    enough : int or None
        After a refusal by the bounds alone: number of fresh draws whose bounds would meet the limits if they varied as these do.
        None if no number would, or if there is another reason.

    Examples
    --------
    >>> import structid as si
    >>> certificate = si.certify(posterior, draws, log_density)  # doctest: +SKIP
    >>> print(certificate)  # doctest: +SKIP
    """

    verdict: CertificateVerdict
    reasons: tuple[str, ...]
    doubts: tuple[str, ...]
    variation: WeightVariation
    mean_bound: np.ndarray
    sd_bound: np.ndarray
    correlation_bound: np.ndarray
    shift: np.ndarray
    shift_error: np.ndarray
    draws: np.ndarray = field(repr=False)
    weights: np.ndarray = field(repr=False)
    log_ratios: np.ndarray = field(repr=False)
    look: int
    above: float
    excess: float
    within_reach: int
    failed: int
    true_runs: int
    limits: Limits
    names: tuple[str, ...]
    correction: Correction | None = None
    subject: str = ""
    searched: int = 0
    taught: int = 0
    missing: float = 0.0
    monte_carlo: MonteCarloError | None = None
    enough: int | None = None

    @property
    def certified(self) -> bool:
        """Whether all limits are met."""
        return self.verdict == "certified"

    @property
    def usable(self) -> bool:
        """Whether at least the re-weighted moments may be used."""
        return self.verdict != "not to be trusted"

    @property
    def only_the_draws(self) -> bool:
        """Whether all reasons concern only the draws, while the model runs agree with their density."""
        return bool(self.doubts) and self.doubts == self.reasons

    @property
    def agreement(self) -> str:
        """Statement on the agreement of surrogate and model, independent of the quality of the draws."""
        if self.certified or self.only_the_draws:
            return "surrogate and model agree"
        return "they agree after re-weighting" if self.usable else "they do not agree"

    def of_probability(self, p: float) -> float:
        """Bound on the error of the probability of an event.

        Parameters
        ----------
        p : float
            Probability of the event for the draws.

        Returns
        -------
        float
            U √(p (1 − p)). A correction adds its distance to p and to the bound.
        """
        if self.correction is None:
            return float(self.variation.of_probability(p))
        distance = self.correction.distance
        return distance + float(self.variation.of_probability(min(p + distance, 0.5)))

    @property
    def unseen(self) -> float:
        """Probability of the largest part of the posterior that all draws may have missed by chance."""
        return min(UNSEEN / self.variation.draws, 1.0)

    @property
    def statement(self) -> str:
        """The certified bounds in a sentence."""
        mean, sd = float(self.mean_within.max()), float(self.sd_within.max())
        correlations = f"every correlation within {self.correlation_within.max():.2g}, " if len(self.names) > 1 else ""
        event = self.of_probability(0.05) + (self.monte_carlo.of_probability(0.05) if self.monte_carlo else 0.0)
        logarithms = any(name.startswith("log ") for name in self.names)
        return (
            f"every mean is within {mean:.2g} standard deviations of the model's, every standard deviation within "
            f"{100.0 * sd:.2g} %, {correlations}the probability of an event of 5 % within {100.0 * event:.2g} %"
            f"{self._monte_carlo_clause}{'; for error variances, this refers to the logarithm' if logarithms else ''}"
        )

    @property
    def _monte_carlo_clause(self) -> str:
        chance = self.monte_carlo
        if chance is None:
            return ""
        kind, also = ("a Monte Carlo error", "") if chance.by_stein is None else ("an error of the draws", STEIN)
        return (
            f"; this includes {kind} of {chance.mean.max():.2g} standard deviations and {100.0 * chance.sd.max():.2g} %, since "
            f"the draws count as {chance.size:.0f} independent draws{also}"
        )

    @property
    def mean_within(self) -> np.ndarray:
        """Bound on the error of each mean of the draws [sd], including its Monte Carlo error, shape (parameter,)."""
        return self.mean_bound + (0.0 if self.monte_carlo is None else self.monte_carlo.mean)

    @property
    def sd_within(self) -> np.ndarray:
        """Bound on the relative error of each standard deviation, including its Monte Carlo error, shape (parameter,)."""
        chance = 0.0 if self.monte_carlo is None else self.monte_carlo.sd
        return np.asarray((1.0 + self.sd_bound) * (1.0 + chance) - 1.0)

    @property
    def correlation_within(self) -> np.ndarray:
        """Bound on the error of each correlation, including its Monte Carlo error, shape (parameter, parameter)."""
        return self.correlation_bound + (0.0 if self.monte_carlo is None else self.monte_carlo.correlation)

    @property
    def unknown(self) -> str:
        """Sentence on the errors that the certificate cannot exclude."""
        share = f" with less than {100.0 * self.unseen:.0f} % of the probability" if self.unseen < 1.0 else ""
        return (
            f"a part of the posterior{share} that no draw has reached, and a mode that no model run of any round has reached"
            f"{'; without q as a function, no second sampler has searched for modes' if self.subject else ''}"
        )

    def __str__(self) -> str:
        worst = int(np.argmax(np.abs(self.shift)))
        limits = self.limits
        head = " ".join([self.verdict.upper(), *self.subject.split()])
        lines = [
            f"{head} ({self._run_counts})",
            *([f"  with {limits.confidence:.0%} confidence {self.statement}"] if self.certified else []),
            f"  {self._weights_clause}; they shift the mean of {self.names[worst]} most, by {self.shift[worst]:+.2f} ± "
            f"{self.shift_error[worst]:.2f} standard deviations",
            *([self._stored_runs_line] if self.within_reach else []),
            *([self._truncated_support_line] if self.missing else []),
            *([RESTS_ON_STEIN] if self._values_of_the_model else []),
            f"  not excluded: {self.unknown}",
            *(f"  - {reason}" for reason in self.reasons),
            *([self._enough_line] if self.enough else []),
        ]
        return "\n".join(lines)

    @property
    def _values_of_the_model(self) -> bool:
        """Whether the given values at the draws are those of the model, so that the runs show nothing further."""
        chance = self.monte_carlo
        return chance is not None and chance.by_stein is not None and self.variation.estimate < OWN

    @property
    def _run_counts(self) -> str:
        others = ((self.searched, "in search of further modes"), (self.taught, "to correct the draws' density"))
        return ", ".join(
            [
                f"{self.true_runs} model runs",
                f"{len(self.draws)} of them at fresh draws",
                *(f"{count} {why}" for count, why in others if count),
            ]
        )

    @property
    def _weights_clause(self) -> str:
        bound = self.variation.bound
        at_most = "at most" if bound < NOTHING else "perhaps"
        estimate, most = number_in_words(self.variation.estimate), number_in_words(bound)
        sentence = f"the weights have a coefficient of variation of {estimate}, {at_most} {most}"
        if self.correction is None:
            return sentence
        return (
            f"{sentence}, relative to a density fitted to the runs, which "
            f"differs from the draws' density in {self.correction.distance:.0%} of the probability"
        )

    @property
    def _enough_line(self) -> str:
        return (
            f"  about {self.enough} model runs at fresh draws in place of {len(self.draws)} would show that the limits are met, if "
            "the weights there vary as they do here"
        )

    @property
    def _stored_runs_line(self) -> str:
        return (
            f"  {self.within_reach} stored model runs lie within {self.limits.reach:g} nats of the best; the drawn density is at "
            f"most {max(self.excess, 0.0):.2f} nats too low there (limit {self.limits.excess:g})"
        )

    @property
    def _truncated_support_line(self) -> str:
        return (
            f"  {self.missing:.2%} of the posterior may lie where the given density is zero, estimated as for a truncated "
            "normal density; the bounds allow for this"
        )

    def to_plain(self) -> dict[str, Any]:
        """Return all results except the draws, in a form that JSON can store.

        Returns
        -------
        dict
            Results by name.
        """
        figures = {k: v for k, v in asdict(self).items() if k not in ("draws", "weights", "log_ratios")}
        figures |= {"statement": self.statement, "unknown": self.unknown, "unseen": self.unseen}
        return _plain(figures)


def issue_certificate(
    fresh: FreshDraws,
    stored: StoredRuns,
    names: tuple[str, ...],
    true_runs: int,
    look: int = 1,
    limits: Limits | None = None,
    doubts: tuple[str, ...] = (),
    against: tuple[str, ...] = (),
    correction: Correction | None = None,
) -> Certificate:
    """Issue a certificate from model runs at fresh draws."""
    limits = Limits() if limits is None else limits
    if len(fresh.theta) < FEWEST_DRAWS:
        raise InputError(
            "certificate", f"{len(fresh.theta)} fresh draws", f"{FEWEST_DRAWS} or more draws, 30 recommended"
        )
    bounds = _bounds(fresh, look, limits, correction)
    variation = bounds.variation
    mean_shift, error = shift(fresh, standardised(fresh))
    if correction is not None:
        mean_shift, error = (
            correction.mean + correction.sd * mean_shift,
            np.hypot(correction.mean_error, correction.sd * error),
        )
    middle = fresh.middle
    excess, within = stored.excess(middle, limits.reach)
    above = stored.above(fresh.highest + middle)
    hidden = stored.understated(middle, limits)
    missing = (*doubts, *against, *_what_is_missing(above, excess, hidden, limits))
    failed = fresh.failed
    if failed:
        missing = (
            f"{failed} of {len(fresh.theta)} model runs at fresh draws failed, although no failure was expected there",
            *missing,
        )
    reasons = (*missing, *_what_varies(bounds, names, limits, correction))
    verdict: CertificateVerdict = "certified"
    if reasons:
        enough = weighted_size(fresh.weights) >= limits.usable_size and variation.bound <= limits.usable
        verdict = "usable with re-weighting" if enough and not missing else "not to be trusted"
    return Certificate(
        verdict,
        reasons,
        doubts,
        variation,
        bounds.mean,
        bounds.sd,
        bounds.correlation,
        mean_shift,
        error,
        fresh.theta,
        fresh.weights,
        fresh.log_ratios,
        look,
        above,
        excess,
        within,
        failed,
        true_runs,
        limits,
        names,
        correction,
        missing=fresh.missing,
        enough=_enough(fresh, look, limits, correction) if reasons and not missing else None,
    )


class _Bounds(NamedTuple):
    """Bounds on the errors of all means, standard deviations and correlations."""

    variation: WeightVariation
    mean: np.ndarray
    sd: np.ndarray
    correlation: np.ndarray

    def within(self, limits: Limits) -> bool:
        """Whether no bound exceeds its limit."""
        pairs = ((self.mean, limits.mean), (self.sd, limits.sd), (self.correlation, limits.correlation))
        return all(bool(bound.max() <= limit) for bound, limit in pairs)


def _bounds(fresh: FreshDraws, look: int, limits: Limits, correction: Correction | None) -> _Bounds:
    """Bounds that model runs at fresh draws show."""
    variation = weight_variation(fresh.log_ratios, fresh.shares, limits.confidence_of(look))
    lost, lost_of_sd = missing_bounds(fresh, variation)
    mean = mean_bound(fresh, variation) + lost + fresh.difference.mean
    sd = (1.0 + sd_bound(fresh, variation)) * (1.0 + fresh.difference.sd) * (1.0 + lost_of_sd) - 1.0
    variation = replace(variation, bound=variation.bound + lost + fresh.difference.variation)
    correlation = correlation_bound(fresh, variation)
    if correction is None:
        return _Bounds(variation, mean, sd, correlation)
    return _Bounds(
        variation, correction.mean_bound(mean), correction.sd_bound(sd), correction.correlation_bound(correlation)
    )


def _enough(fresh: FreshDraws, look: int, limits: Limits, correction: Correction | None) -> int | None:
    """Number of fresh draws that would show the limits to be met if they varied as these do; None if no number would."""
    for times in MORE_DRAWS:
        if _bounds(fresh.repeated(times), look, limits, correction).within(limits):
            return times * len(fresh.theta)
    return None


def _what_varies(
    bounds: _Bounds, names: tuple[str, ...], limits: Limits, correction: Correction | None
) -> tuple[str, ...]:
    """Describe each limit that the weights, or the correction from the runs, exceed."""
    reasons = []
    _, mean_off, sd_off, correlation_off = bounds
    furthest, widest = int(np.argmax(mean_off)), int(np.argmax(sd_off))
    because = (
        f"according to the weights, the mean of {names[furthest]} "
        if correction is None
        else f"according to the model runs, {correction.said_of(furthest, names[furthest])}, and "
    )
    if not mean_off[furthest] <= limits.mean:
        reasons.append(
            f"{because}may be wrong by {number_in_words(mean_off[furthest])} standard deviations; the limit is {limits.mean:g}"
        )
    if not sd_off[widest] <= limits.sd:
        reasons.append(
            f"the standard deviation of {names[widest]} may be wrong by {_percent(sd_off[widest])}; the limit is {limits.sd:.0%}"
        )
    if not correlation_off.max() <= limits.correlation:
        one, other = np.unravel_index(np.argmax(np.triu(correlation_off)), correlation_off.shape)
        reasons.append(
            f"the correlation of {names[one]} and {names[other]} may be wrong by {min(correlation_off[one, other], 2.0):.2g}; "
            f"the limit is {limits.correlation:g}"
        )
    return tuple(reasons)


def _what_is_missing(above: float, excess: float, hidden: int, limits: Limits) -> tuple[str, ...]:
    """Describe parts of the posterior that the draws have missed, according to the stored model runs."""
    reasons = []
    if above > limits.above:
        reasons.append(
            f"a stored model run is {above:.1f} nats above every draw: the draws have missed the region of highest density"
        )
    if excess > limits.excess:
        more = (
            f"exceeds the drawn density by {'over 100' if excess > 100.0 else f'{excess:.1f}'} nats"
            if np.isfinite(excess)
            else "lies where the drawn density is zero"
        )
        reasons.append(
            f"a model run within {limits.reach:g} nats of the best {more}: the drawn density misses a part of the true posterior"
        )
    if hidden:
        reasons.append(
            f"the drawn density is much too low at {hidden} stored model runs further away: it may miss a mode there"
        )
    return tuple(reasons)


def _plain(figures: dict[str, Any]) -> dict[str, Any]:
    return {
        k: v.tolist() if isinstance(v, np.ndarray) else _plain(v) if isinstance(v, dict) else v
        for k, v in figures.items()
    }


def number_in_words(value: float) -> str:
    """A bound or a difference, unless it is too large to mean anything."""
    return f"{value:.2g}" if value < NOTHING else f"more than {NOTHING:g}"


def _percent(value: float) -> str:
    return f"{value:.0%}" if value < NOTHING else f"more than {NOTHING:.0%}"
