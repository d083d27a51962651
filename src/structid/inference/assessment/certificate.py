"""May the posterior under a surrogate be believed? Importance weights of true runs at fresh draws of it say so.

The weights are w = π_true/π_surrogate at draws of π_surrogate that no surrogate has seen. Their Pareto-smoothed tail index k̂
(Vehtari, Simpson, Gelman, Yao & Gabry 2024, JMLR 25(72)), effective size and scatter show how far apart the two posteriors are
where the surrogate's has mass. The true runs of all rounds, tempered draws among them, check that it misses no mass.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any, Literal

import numpy as np

from structid.errors import InputError
from structid.inference.assessment.pareto_smoothing import smoothed_weights
from structid.notebook import ShownAsText

CertificateVerdict = Literal["certified", "usable with re-weighting", "not to be trusted"]

FEWEST_DRAWS = 50
"""Fewer fresh draws say nothing about a tail: with 50, k̂ itself has a standard deviation of 0.24."""


@dataclass(frozen=True)
class Limits:
    """Limits that a certificate must meet.

    Parameters
    ----------
    k_hat : float
        Largest tail index of the weights; for n draws at most 1 − 1/log₁₀ n.
    effective_share : float
        Smallest effective share of the draws, (Σw)²/(n Σw²).
    spread : float
        Largest standard deviation of log w.
    reach : float
        Stored true runs whose log density is within this distance of the best one are checked [nat].
    excess : float
        Largest log(π_true/π_surrogate) of such a run above the median over the draws [nat].
    understated : float
        The surrogate may understate runs further from the best by this share of their distance. A surrogate that is worse there
        could hide a mode that no draw visits.
    shift : float
        Largest shift of a mean by re-weighting, in posterior standard deviations, give or take twice its Monte-Carlo error.
    usable_size : float
        Smallest effective number of draws with which re-weighted moments may be used.
    """

    k_hat: float = 0.7
    effective_share: float = 0.8
    spread: float = 0.3
    reach: float = 10.0
    excess: float = 3.0
    understated: float = 0.5
    shift: float = 0.1
    usable_size: float = 50.0

    def largest_k_hat(self, draws: int) -> float:
        """Largest k̂ allowed for this many draws.

        Parameters
        ----------
        draws : int
            n.

        Returns
        -------
        float
            min(1 − 1/log₁₀ n, the limit).
        """
        return float(min(1.0 - 1.0 / np.log10(draws), self.k_hat))


@dataclass(frozen=True, eq=False)
class Certificate(ShownAsText):
    """Whether a surrogate's posterior may be believed, and why.

    Parameters
    ----------
    verdict : {"certified", "usable with re-weighting", "not to be trusted"}
        Certified: use the draws as they are. Usable: use re-weighted moments and quantiles. Otherwise: do more true runs.
    reasons : tuple of str
        What fell short, one sentence each.
    draws : ndarray, shape (draw, parameter)
        The fresh draws, in SI.
    weights : ndarray, shape (draw,)
        Their smoothed weights, which sum to one.
    k_hat : float
        Tail index of the weights; −∞ where they are equal up to rounding.
    effective_sample_size : float
        (Σw)²/Σw².
    spread : float
        Standard deviation of log w; infinite where a true run failed.
    shift : ndarray, shape (parameter,)
        How far re-weighting moves each mean, in posterior standard deviations.
    shift_error : ndarray, shape (parameter,)
        Monte-Carlo error of that.
    excess : float
        Largest log(π_true/π_surrogate), above the median over the draws, of the stored true runs within reach of the best [nat].
    within_reach : int
        Number of those stored runs.
    failed : int
        Fresh draws whose true run failed.
    true_runs : int
        True runs spent in all, including those of the certificate.
    limits : Limits
        The limits it had to meet.
    names : tuple of str
        Parameters.
    """

    verdict: CertificateVerdict
    reasons: tuple[str, ...]
    draws: np.ndarray = field(repr=False)
    weights: np.ndarray = field(repr=False)
    k_hat: float
    effective_sample_size: float
    spread: float
    shift: np.ndarray
    shift_error: np.ndarray
    excess: float
    within_reach: int
    failed: int
    true_runs: int
    limits: Limits
    names: tuple[str, ...]

    @property
    def certified(self) -> bool:
        """Whether everything holds."""
        return self.verdict == "certified"

    @property
    def usable(self) -> bool:
        """Whether re-weighted moments, at least, may be used."""
        return self.verdict != "not to be trusted"

    @property
    def agreement(self) -> str:
        """What it says of surrogate and model, whatever the draws are worth."""
        return {
            "certified": "surrogate and model agree",
            "usable with re-weighting": "they agree after re-weighting",
        }.get(self.verdict, "they do not agree")

    @property
    def largest_shift(self) -> float:
        """Largest shift of a mean by re-weighting, in standard deviations."""
        return float(np.abs(self.shift).max())

    def __str__(self) -> str:
        return self.said()

    def said(self, converged: bool = True) -> str:
        """Give the verdict and the figures behind it.

        Parameters
        ----------
        converged : bool
            Whether the draws that it is about have converged. If not, nothing is called certified.

        Returns
        -------
        str
            Some lines.
        """
        count, limits = len(self.draws), self.limits
        worst = int(np.argmax(np.abs(self.shift)))
        agree = self.certified and not converged
        head = (
            "NOT CERTIFIED: surrogate and model agree, but the draws have not converged"
            if agree
            else self.verdict.upper()
        )
        lines = [
            f"{head} ({self.true_runs} true runs, {count} of them at fresh draws)",
            f"  tail index of the weights {_number(self.k_hat)} (below {limits.largest_k_hat(count):.2f}), "
            f"effective {self.effective_sample_size:.0f} of {count} (at least {limits.effective_share * count:.0f}), "
            f"spread of log w {_number(self.spread)} (at most {limits.spread:g})",
            f"  {self.within_reach} stored true runs lie within {limits.reach:g} nats of the best; the surrogate misses at most "
            f"{max(self.excess, 0.0):.2f} nats there (at most {limits.excess:g})",
            f"  re-weighting moves the mean of {self.names[worst]} most, by {self.shift[worst]:+.2f} ± "
            f"{self.shift_error[worst]:.2f} standard deviations",
            *(f"  - {reason}" for reason in self.reasons),
        ]
        return "\n".join(lines)

    def to_plain(self) -> dict[str, Any]:
        """Give all figures except the draws, in a form that JSON can hold.

        Returns
        -------
        dict
            By name.
        """
        listed = {"shift", "shift_error"}
        said = {k: v for k, v in asdict(self).items() if k not in ("draws", "weights")}
        return {k: v.tolist() if k in listed else v for k, v in said.items()}


def _number(value: float) -> str:
    return f"{value:.2f}" if np.isfinite(value) else ("none" if value < 0 else "infinite")


@dataclass(frozen=True, eq=False)
class StoredRuns:
    """Log densities at true runs of all rounds.

    Parameters
    ----------
    log_true, log_surrogate : ndarray, shape (run,)
        Log posterior densities there under the true model and under the surrogate, at the same discrepancy.
    """

    log_true: np.ndarray
    log_surrogate: np.ndarray


def certify(
    draws: np.ndarray,
    log_true: np.ndarray,
    log_surrogate: np.ndarray,
    stored: StoredRuns,
    names: tuple[str, ...],
    true_runs: int,
    limits: Limits | None = None,
    impossible: np.ndarray | None = None,
) -> Certificate:
    """Judge a surrogate's posterior by true runs at fresh draws of it.

    Parameters
    ----------
    draws : ndarray, shape (draw, parameter)
        Draws of the surrogate's posterior that no surrogate was fitted to, in SI.
    log_true, log_surrogate : ndarray, shape (draw,)
        Log posterior densities there, −inf where a true run failed.
    stored : StoredRuns
        True runs of all rounds.
    names : tuple of str
        Parameters.
    true_runs : int
        True runs spent in all.
    limits : Limits, optional
        The limits to meet.
    impossible : ndarray of bool, shape (draw,), optional
        Draws at which −inf is the model's answer, such as a structure that failed, and no failed run. They weigh nothing.

    Returns
    -------
    Certificate
        The verdict and its figures.

    Raises
    ------
    InputError
        If there are too few draws.
    """
    limits = Limits() if limits is None else limits
    count = len(draws)
    if count < FEWEST_DRAWS:
        raise InputError("certify", f"{count} fresh draws", f"{FEWEST_DRAWS} or more, best 200")
    ran = np.isfinite(log_true)
    ratios = np.where(ran, log_true - log_surrogate, -np.inf)
    failed = int((~ran if impossible is None else ~ran & ~impossible).sum())
    weights, k_hat = smoothed_weights(ratios)
    size = 1.0 / float(np.sum(weights**2))
    spread = float(np.std(ratios[ran])) if failed == 0 and ran.any() else float("inf")
    shift, error = _shift(draws, weights)
    excess, within = _excess(stored, ratios, limits.reach)
    hidden = _understated(stored, ratios, limits)
    reasons = []
    if failed:
        reasons.append(f"{failed} of {count} true runs at fresh draws failed, where the surrogate sees nothing wrong")
    largest = limits.largest_k_hat(count)
    if not k_hat < largest:
        reasons.append(f"the tail of the weights is too heavy: k̂ = {k_hat:.2f}, not below {largest:.2f}")
    if not size >= limits.effective_share * count:
        reasons.append(f"only {size:.0f} of {count} draws are effective after re-weighting")
    if not spread <= limits.spread:
        reasons.append(f"log weights spread by {_number(spread)}, more than {limits.spread:g}")
    surely = np.abs(shift) - 2.0 * error
    if surely.max() > limits.shift:
        worst = int(np.argmax(surely))
        reasons.append(
            f"re-weighting moves the mean of {names[worst]} by {shift[worst]:+.2f} ± {error[worst]:.2f} standard deviations, more "
            f"than {limits.shift:g}"
        )
    missed = excess > limits.excess
    if missed:
        reasons.append(
            f"a stored true run within {limits.reach:g} nats of the best has {excess:.1f} nats more density than the surrogate "
            "gives it: the surrogate's posterior misses a part of the true one"
        )
    if hidden:
        reasons.append(
            f"{hidden} stored true runs further away have far more density than the surrogate gives them: it may hide a mode there"
        )
    verdict: CertificateVerdict = "certified"
    if reasons:
        usable = not missed and not hidden and not failed and k_hat < largest and size >= limits.usable_size
        verdict = "usable with re-weighting" if usable else "not to be trusted"
    return Certificate(
        verdict, tuple(reasons), draws, weights, k_hat, size, spread, shift, error, excess, within, failed, true_runs,
        limits, names,
    )  # fmt: skip


def _shift(draws: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Σ (w − 1/n) θ of every parameter, and its Monte-Carlo error, in standard deviations of the draws."""
    sd = draws.std(axis=0)
    standard = (draws - draws.mean(axis=0)) / np.where(sd > 0, sd, 1.0)
    shift = weights @ standard
    # Of a self-normalised estimate, with what the unweighted mean shares taken out.
    contributions = (weights - 1.0 / len(weights))[:, None] * standard - weights[:, None] * shift
    return shift, np.sqrt(np.sum(contributions**2, axis=0))


def _understated(stored: StoredRuns, ratios: np.ndarray, limits: Limits) -> int:
    """Number of stored runs beyond reach that the surrogate understates by more than a share of their depth below the best."""
    ran = np.isfinite(stored.log_true)
    if not ran.any():
        return 0
    depth = stored.log_true[ran].max() - stored.log_true[ran]
    gap = stored.log_true[ran] - stored.log_surrogate[ran] - _middle(ratios)
    return int(np.count_nonzero((depth > limits.reach) & (gap > np.maximum(limits.excess, limits.understated * depth))))


def _middle(ratios: np.ndarray) -> float:
    """Median of the finite ones."""
    finite = ratios[np.isfinite(ratios)]
    return float(np.median(finite)) if len(finite) else 0.0


def _excess(stored: StoredRuns, ratios: np.ndarray, reach: float) -> tuple[float, int]:
    """Largest log ratio of the stored runs that matter, above the median of the draws, and how many matter."""
    ran = np.isfinite(stored.log_true)
    if not ran.any():
        return float("-inf"), 0
    near = ran & (stored.log_true >= stored.log_true[ran].max() - reach)
    gap = stored.log_true[near] - stored.log_surrogate[near]
    return float(gap.max() - _middle(ratios)), int(near.sum())
