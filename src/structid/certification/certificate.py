"""The certificate of a posterior that was not drawn from the model itself, by model runs at fresh draws of it.

One number carries the statement: χ, the coefficient of variation of the weights w = π/q of the true posterior π over the drawn
one, q; see `weight_variation`. The certificate holds if an upper bound of χ, from few fresh draws, is small enough for every mean
and every standard deviation. Draws of q cannot show mass of π where q has none; the stored model runs of all rounds are searched
for it.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from typing import Any, Literal

import numpy as np

from structid.certification.correction import Correction
from structid.certification.fresh_draws import FreshDraws, StoredRuns
from structid.certification.limits import Limits
from structid.certification.moment_bounds import correlation_bound, missing_bounds, sd_bound, shift, standardised
from structid.certification.monte_carlo_error import MonteCarloError
from structid.certification.weight_variation import WeightVariation, weight_variation
from structid.core.errors import InputError
from structid.core.notebook import ShownAsText
from structid.inference.convergence import weighted_size

CertificateVerdict = Literal["certified", "usable with re-weighting", "not to be trusted"]

FEWEST_DRAWS = 15
"""Minimum number of fresh draws: with fewer, the bound of a variance would exceed three times the estimate."""

NOTHING = 10.0
"""Bound above which it is reported only as "more than" this."""

UNSEEN = 3.0
"""With a probability of 5 %, none of n draws falls into a set of probability 3/n."""


@dataclass(frozen=True, eq=False)
class Certificate(ShownAsText):
    """Whether a posterior that was not drawn from the model itself may be believed, and why.

    Parameters
    ----------
    verdict : {"certified", "usable with re-weighting", "not to be trusted"}
        Certified: use the draws as they are. Usable: use re-weighted moments and quantiles. Otherwise: do more model runs.
    reasons : tuple of str
        What fell short, one sentence each.
    doubts : tuple of str
        Those of them that concern the draws, whatever the model says: they have not converged, or another explorer finds others.
    variation : WeightVariation
        χ̂ and its bound U.
    mean_bound : ndarray, shape (parameter,)
        How far each mean may be off, in standard deviations: U, or less where the runs have taught a correction.
    sd_bound : ndarray, shape (parameter,)
        How far each standard deviation may be off, as a share of it.
    correlation_bound : ndarray, shape (parameter, parameter)
        How far the correlation of each two parameters may be off.
    shift, shift_error : ndarray, shape (parameter,)
        How far the weights move each mean, in standard deviations, and the Monte-Carlo error of that.
    draws : ndarray, shape (draw, parameter)
        The fresh draws, in SI.
    weights : ndarray, shape (draw,)
        Their weights in averages over the true posterior, which sum to one.
    log_ratios : ndarray, shape (draw,)
        log π/q of each, up to a constant; −inf where a model run failed.
    look : int
        1 for the first certificate that was asked for, 2 for one after a refusal, and so on.
    above : float
        By how much the best stored model run exceeds the best draw [nat].
    excess : float
        Largest log π/q, above the median over the draws, of the stored model runs within reach of the best [nat].
    within_reach : int
        Number of those stored runs.
    failed : int
        Fresh draws whose model run failed.
    true_runs : int
        Model runs spent in all, including those of the certificate.
    limits : Limits
        The limits it had to meet.
    names : tuple of str
        Parameters, or their logarithms; see `Target.compared`.
    correction : Correction or None
        What the runs have taught of q, where the weights of the draws alone did not decide.
    subject : str
        What is certified, where it is not the draws.
    searched, taught : int
        Model runs that searched for modes the draws have missed, and that were made to learn where the draws' density is wrong.
    missing : float
        Share of the posterior that may lie where the draws' density is zero; the bounds allow for it.
    monte_carlo : MonteCarloError or None
        How far moments of the draws may be from those of their density, which the bounds above are about. Of external draws;
        those of a calibration have their own verdict.

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

    @property
    def certified(self) -> bool:
        """Whether all limits are met."""
        return self.verdict == "certified"

    @property
    def usable(self) -> bool:
        """Whether re-weighted moments, at least, may be used."""
        return self.verdict != "not to be trusted"

    @property
    def only_the_draws(self) -> bool:
        """Whether only the draws themselves are insufficient, while the model runs agree with them."""
        return bool(self.doubts) and self.doubts == self.reasons

    @property
    def agreement(self) -> str:
        """Statement on the drawn and the model's posterior, independent of the quality of the draws."""
        if self.certified or self.only_the_draws:
            return "surrogate and model agree"
        return "they agree after re-weighting" if self.usable else "they do not agree"

    def of_probability(self, p: float) -> float:
        """How far the probability of an event may be off.

        Parameters
        ----------
        p : float
            What it is for the draws.

        Returns
        -------
        float
            U √(p (1 − p)); where the runs have taught a correction, by whose distance p may be larger, this distance more.
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
        """The certified figures in a sentence."""
        mean, sd = float(self.mean_within.max()), float(self.sd_within.max())
        correlations = f"every correlation within {self.correlation_within.max():.2g}, " if len(self.names) > 1 else ""
        event = self.of_probability(0.05) + (self.monte_carlo.of_probability(0.05) if self.monte_carlo else 0.0)
        logarithms = any(name.startswith("log ") for name in self.names)
        return (
            f"every mean is within {mean:.2g} standard deviations of the model's, every standard deviation within "
            f"{100.0 * sd:.2g} %, {correlations}the probability of an event of 5 % within {100.0 * event:.2g} %"
            f"{self._said_of_draws}{'; of a variance of errors its logarithm is meant' if logarithms else ''}"
        )

    @property
    def _said_of_draws(self) -> str:
        chance = self.monte_carlo
        if chance is None:
            return ""
        return (
            f"; {chance.mean.max():.2g} standard deviations and {100.0 * chance.sd.max():.2g} % of this are the Monte Carlo error "
            f"of the draws, which count as {chance.size:.0f} independent ones"
        )

    @property
    def mean_within(self) -> np.ndarray:
        """Bound on the error of each mean of the draws [sd], including its Monte Carlo error, shape (parameter,)."""
        return self.mean_bound + (0.0 if self.monte_carlo is None else self.monte_carlo.mean)

    @property
    def sd_within(self) -> np.ndarray:
        """Bound on the relative error of each standard deviation, likewise, shape (parameter,)."""
        chance = 0.0 if self.monte_carlo is None else self.monte_carlo.sd
        return np.asarray((1.0 + self.sd_bound) * (1.0 + chance) - 1.0)

    @property
    def correlation_within(self) -> np.ndarray:
        """Bound on the error of each correlation, likewise, shape (parameter, parameter)."""
        return self.correlation_bound + (0.0 if self.monte_carlo is None else self.monte_carlo.correlation)

    @property
    def unknown(self) -> str:
        """What the certificate cannot exclude, in a sentence."""
        share = f" with less than {100.0 * self.unseen:.0f} % of the probability" if self.unseen < 1.0 else ""
        return (
            f"a part of the posterior{share}, into which none of the draws fell, and a mode that no model run of any round has "
            f"touched{'; without a density that is a function no second explorer has looked for one' if self.subject else ''}"
        )

    def __str__(self) -> str:
        worst = int(np.argmax(np.abs(self.shift)))
        limits = self.limits
        head = " ".join([self.verdict.upper(), *self.subject.split()])
        lines = [
            f"{head} ({self._said_of_runs})",
            *([f"  with {limits.confidence:.0%} confidence {self.statement}"] if self.certified else []),
            f"  {self._said_of_weights}; they move the mean of {self.names[worst]} most, by {self.shift[worst]:+.2f} ± "
            f"{self.shift_error[worst]:.2f} standard deviations",
            *([self._said_of_stored_runs] if self.within_reach else []),
            *([self._said_of_what_is_excluded] if self.missing else []),
            f"  not known: {self.unknown}",
            *(f"  - {reason}" for reason in self.reasons),
        ]
        return "\n".join(lines)

    @property
    def _said_of_runs(self) -> str:
        others = ((self.searched, "in search of further modes"), (self.taught, "to learn where the draws are wrong"))
        return ", ".join(
            [
                f"{self.true_runs} model runs",
                f"{len(self.draws)} of them at fresh draws",
                *(f"{count} {why}" for count, why in others if count),
            ]
        )

    @property
    def _said_of_weights(self) -> str:
        bound = self.variation.bound
        at_most = "at most" if bound < NOTHING else "perhaps by"
        sentence = f"weights vary by {_number(self.variation.estimate)}, {at_most} {_number(bound)}"
        if self.correction is None:
            return f"{sentence} ({self.limits.mean:g} is allowed)"
        return (
            f"{sentence}, about a density fitted to the runs and that "
            f"differs from that of the draws in {self.correction.distance:.0%} of the probability"
        )

    @property
    def _said_of_stored_runs(self) -> str:
        return (
            f"  {self.within_reach} stored model runs lie within {self.limits.reach:g} nats of the best; what was drawn misses at "
            f"most {max(self.excess, 0.0):.2f} nats there (at most {self.limits.excess:g})"
        )

    @property
    def _said_of_what_is_excluded(self) -> str:
        return (
            f"  {self.missing:.2%} of the posterior may lie where the given density is zero, as of a normal density that ends "
            "there; the bounds allow for it"
        )

    def to_plain(self) -> dict[str, Any]:
        """Give all figures except the draws, in a form that JSON can hold.

        Returns
        -------
        dict
            By name.
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
        raise InputError("certificate", f"{len(fresh.theta)} fresh draws", f"{FEWEST_DRAWS} or more, best 30")
    variation = weight_variation(fresh.log_ratios, fresh.shares, limits.confidence_of(look))
    lost, lost_of_sd = missing_bounds(fresh, variation)
    mean_off = variation.bound + lost + np.broadcast_to(fresh.difference.mean, len(names))
    sd_off = (1.0 + sd_bound(fresh, variation)) * (1.0 + fresh.difference.sd) * (1.0 + lost_of_sd) - 1.0
    variation = replace(variation, bound=variation.bound + lost + fresh.difference.variation)
    correlation_off = correlation_bound(fresh, variation)
    mean_shift, error = shift(fresh, standardised(fresh))
    if correction is not None:
        mean_off, sd_off = correction.mean_bound(mean_off), correction.sd_bound(sd_off)
        correlation_off = correction.correlation_bound(correlation_off)
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
            f"{failed} of {len(fresh.theta)} model runs at fresh draws failed, where nothing wrong was foreseen",
            *missing,
        )
    reasons = (*missing, *_what_varies(variation, mean_off, sd_off, correlation_off, names, limits, correction))
    verdict: CertificateVerdict = "certified"
    if reasons:
        enough = weighted_size(fresh.weights) >= limits.usable_size and variation.bound <= limits.usable
        verdict = "usable with re-weighting" if enough and not missing else "not to be trusted"
    return Certificate(
        verdict,
        reasons,
        doubts,
        variation,
        mean_off,
        sd_off,
        correlation_off,
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
    )


def _what_varies(
    variation: WeightVariation,
    mean_off: np.ndarray,
    sd_off: np.ndarray,
    correlation_off: np.ndarray,
    names: tuple[str, ...],
    limits: Limits,
    correction: Correction | None,
) -> tuple[str, ...]:
    """Failures of the weights, or of what the runs have taught."""
    reasons = []
    furthest, widest = int(np.argmax(mean_off)), int(np.argmax(sd_off))
    because = (
        f"the weights of the draws may vary by {_number(variation.bound)}, so that the mean of {names[furthest]} "
        if correction is None
        else f"as the runs have taught, {correction.said_of(furthest, names[furthest])}, and "
    )
    if not mean_off[furthest] <= limits.mean:
        reasons.append(
            f"{because}may be {_number(mean_off[furthest])} standard deviations off; {limits.mean:g} is allowed"
        )
    if not sd_off[widest] <= limits.sd:
        reasons.append(
            f"the standard deviation of {names[widest]} may be {_percent(sd_off[widest])} off, and {limits.sd:.0%} is allowed"
        )
    if not correlation_off.max() <= limits.correlation:
        one, other = np.unravel_index(np.argmax(np.triu(correlation_off)), correlation_off.shape)
        reasons.append(
            f"the correlation of {names[one]} and {names[other]} may be {min(correlation_off[one, other], 2.0):.2g} off; "
            f"{limits.correlation:g} is allowed"
        )
    return tuple(reasons)


def _what_is_missing(above: float, excess: float, hidden: int, limits: Limits) -> tuple[str, ...]:
    """Failures that stored model runs reveal: probability that the draws do not visit."""
    reasons = []
    if above > limits.above:
        reasons.append(
            f"a stored model run has {above:.1f} nats more density than any draw: the draws have missed where most of it is"
        )
    if excess > limits.excess:
        more = (
            f"has {'over 100' if excess > 100.0 else f'{excess:.1f}'} nats more density than"
            if np.isfinite(excess)
            else "lies where there is no density at all in"
        )
        reasons.append(
            f"a model run within {limits.reach:g} nats of the best {more} the drawn density: it misses a part of the true one"
        )
    if hidden:
        reasons.append(
            f"{hidden} stored model runs further away have far more density than the drawn density gives them: it may hide a "
            "mode there"
        )
    return tuple(reasons)


def _plain(figures: dict[str, Any]) -> dict[str, Any]:
    return {
        k: v.tolist() if isinstance(v, np.ndarray) else _plain(v) if isinstance(v, dict) else v
        for k, v in figures.items()
    }


def _number(value: float) -> str:
    return f"{value:.2g}" if value < NOTHING else f"more than {NOTHING:g}"


def _percent(value: float) -> str:
    return f"{value:.0%}" if value < NOTHING else f"more than {NOTHING:.0%}"
