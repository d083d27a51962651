"""Comparison of model classes by evidence, and by the predictive density of stretches of the measurement left out in turn.

A. Vehtari, A. Gelman & J. Gabry (2017), doi 10.1007/s11222-016-9696-4. The values of one history depend on each other, so whole
stretches are left out, not single values. The density of a stretch is conditional on the values measured before it.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float
from scipy.special import logsumexp

from structid.core.errors import InputError
from structid.core.notebook import ShownAsText
from structid.inference.likelihood.posterior import Posterior
from structid.inference.model_comparison.pareto_smoothing import smoothed_weights
from structid.inference.sampling.base import Evidence

BLOCKS = 40
"""Number of stretches of a history."""
GOOD_K_HAT = 0.7
"""Pareto tail index above which importance weights cannot represent the posterior without a stretch."""


@dataclass(frozen=True, eq=False)
class LeaveOut:
    """Expected log predictive density, stretch by stretch."""

    each: Float[np.ndarray, " block"] = field(repr=False)  # log density of each stretch given the other stretches [nat]
    k_hat: Float[np.ndarray, " block"] = field(repr=False)  # tail index of the weights that leave it out

    @property
    def value(self) -> float:
        """Sum over the stretches [nat]."""
        return float(self.each.sum())

    @property
    def error(self) -> float:
        """Standard error of the sum over the stretches, from their scatter [nat]."""
        return float(np.sqrt(len(self.each) * self.each.var(ddof=1)))

    @property
    def unreliable(self) -> int:
        """Number of stretches whose importance weights are too heavy-tailed."""
        return int(np.count_nonzero(self.k_hat > GOOD_K_HAT))

    def less(self, other: LeaveOut) -> tuple[float, float]:
        """Difference in log predictive density from another class on the same stretches, with its standard error."""
        gap = self.each - other.each
        return float(gap.sum()), float(np.sqrt(len(gap) * gap.var(ddof=1)))


def leave_out(posterior: Posterior, draws: Float[np.ndarray, "draw parameter"], blocks: int = BLOCKS) -> LeaveOut:
    """Cross-validate over stretches of the measurements by Pareto-smoothed importance sampling."""
    each, tails = [], []
    for index, observation in enumerate(posterior.observations):
        measured = observation.is_measured.any(axis=1)
        if not 2 <= blocks <= np.count_nonzero(measured):
            raise InputError("leave_out(blocks)", f"{blocks}", f"2 to {np.count_nonzero(measured)}")
        pointwise = posterior.pointwise_log_likelihood(draws, index)[:, measured].sum(axis=2)
        pointwise = pointwise[np.isfinite(pointwise).all(axis=1)]
        edges = np.linspace(0, pointwise.shape[1], blocks + 1).astype(int)[:-1]
        for density in np.add.reduceat(pointwise, edges, axis=1).T:
            weights, k_hat = smoothed_weights(-density)
            each.append(logsumexp(density, b=weights))
            tails.append(k_hat)
    return LeaveOut(np.array(each), np.array(tails))


@dataclass(frozen=True, eq=False)
class ModelClass:
    """Results of one model class."""

    name: str  # name of the class
    evidence: Evidence | None  # log Z; None where it is unknown
    left_out: LeaveOut  # predictive density by stretches
    parameters: int  # number of parameters
    unexplained: float  # residual variance of its best prediction over the measurement's variance
    inside: float  # fraction of the measurement inside its 90 % predictive band
    trusted: bool  # whether its draws have converged, and are certified if they use a surrogate


@dataclass(frozen=True, eq=False)
class Comparison(ShownAsText):
    """Comparison of model classes."""

    classes: tuple[ModelClass, ...]  # at least two, of the same measurements

    def __post_init__(self) -> None:
        if len(self.classes) < 2:
            raise InputError("compare", f"{len(self.classes)} model class", "two or more model classes")

    @property
    def by_evidence(self) -> bool:
        """Whether the evidence of every class is known."""
        return all(c.evidence is not None for c in self.classes)

    @property
    def best(self) -> ModelClass:
        """The class with the largest evidence, or with the largest predictive density if an evidence is unknown."""
        return max(self.classes, key=self._score)

    def _score(self, one: ModelClass) -> float:
        return one.evidence.value if self.by_evidence and one.evidence is not None else one.left_out.value

    def bayes_factor(self, one: ModelClass) -> tuple[float, float]:
        """Log Bayes factor of a class against the best."""
        best = self.best
        if one.evidence is None or best.evidence is None:
            return float("nan"), float("nan")
        between, error = one.evidence - best.evidence
        return between, 0.0 if one is best else error

    @property
    def probabilities(self) -> np.ndarray:
        """Posterior probabilities of the classes from equal prior probabilities, shape (class,); NaN if an evidence is unknown."""
        if not self.by_evidence:
            return np.full(len(self.classes), np.nan)
        values = np.array([c.evidence.value for c in self.classes if c.evidence is not None])
        return np.asarray(np.exp(values - logsumexp(values)))

    @property
    def verdict(self) -> str:
        """The result in a sentence."""
        best, others = self.best, sorted((c for c in self.classes if c is not self.best), key=self._score)
        second = others[-1]
        if self.by_evidence:
            gap, error = self.bayes_factor(second)
            strength = (
                "clearly favours"
                if -gap > 5 + 2 * error
                else "slightly favours"
                if -gap > 1 + 2 * error
                else "is inconclusive and largest for"
            )
            sentence = (
                f"The evidence {strength} {best.name}: log Bayes factor {-gap:.1f} ± {error:.1f} against {second.name}."
            )
        else:
            gap, error = second.left_out.less(best.left_out)
            sentence = f"{best.name} best predicts the stretches left out, by {-gap:.1f} ± {error:.1f} nats over {second.name}."
        doubtful = [c.name for c in self.classes if not c.trusted]
        if doubtful:
            sentence += f" Unreliable, because not converged or not certified: {', '.join(doubtful)}."
        return sentence

    def rows(self) -> tuple[list[str], list[list[str]]]:
        """The results as text."""
        heads = [
            "model class",
            "parameters",
            "log evidence",
            "log Bayes factor",
            "probability",
            "log predictive density",
            "from the best",
            "unexplained",
            "inside 90 %",
        ]
        rows = []
        for one, probability in sorted(
            zip(self.classes, self.probabilities, strict=True), key=lambda pair: -self._score(pair[0])
        ):
            factor, factor_error = self.bayes_factor(one)
            less, less_error = one.left_out.less(self.best.left_out)
            first = one is self.best
            flawed = f" ({one.left_out.unreliable} unreliable)" if one.left_out.unreliable else ""
            rows.append(
                [
                    one.name + ("" if one.trusted else " (not to be trusted)"),
                    str(one.parameters),
                    "–" if one.evidence is None else f"{one.evidence.value:.2f} ± {one.evidence.error:.2f}",
                    "–" if first or np.isnan(factor) else f"{factor:.2f} ± {factor_error:.2f}",
                    _probability(probability),
                    f"{one.left_out.value:.1f} ± {one.left_out.error:.1f}{flawed}",
                    "–" if first else f"{less:.1f} ± {less_error:.1f}",
                    f"{100 * one.unexplained:.2g} %",
                    f"{100 * one.inside:.0f} %",
                ]
            )
        return heads, rows

    def side_by_side(self) -> tuple[list[str], list[list[str]]]:
        """The results with a column for each class, and a full description of each row."""
        _, rows = self.rows()
        meanings = [
            "parameters, including the error model's",
            "log evidence [nat]",
            "log Bayes factor against the best [nat]",
            "probability among these classes",
            "log predictive density of all stretches left out [nat]",
            "difference in log predictive density from the best class [nat]",
            "residual variance of the best prediction",
            "measured values inside the 90 % band",
        ]
        return ["", *(row[0] for row in rows)], [
            [t, *(row[i] for row in rows)] for i, t in enumerate(meanings, start=1)
        ]

    def __str__(self) -> str:
        return "\n".join([self.verdict, *aligned(*self.rows())])


def _probability(value: float) -> str:
    if np.isnan(value):
        return "–"
    return "> 0.999" if value > 0.999 else "< 0.001" if value < 0.001 else f"{value:.3f}"


def aligned(heads: list[str], rows: list[list[str]]) -> list[str]:
    """Lines of a table with aligned columns."""
    widths = [max(len(r[i]) for r in [heads, *rows]) for i in range(len(heads))]
    return ["  ".join(c.ljust(w) for c, w in zip(r, widths, strict=True)).rstrip() for r in [heads, *rows]]
