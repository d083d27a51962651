"""Which model class the data favour, by evidence and by the predictive density of stretches of the measurement left out in turn.

A. Vehtari, A. Gelman & J. Gabry (2017), doi 10.1007/s11222-016-9696-4. The values of one history depend on each other, so whole
stretches are left out, not single values; the density of a stretch is conditional on what was measured before it.
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
"""Stretches that a history is cut into."""
GOOD_K_HAT = 0.7
"""Tail index above which leaving a stretch out changes the posterior too much for weights to represent."""


@dataclass(frozen=True, eq=False)
class LeaveOut:
    """Expected log predictive density, stretch by stretch."""

    each: Float[np.ndarray, " block"] = field(repr=False)  # Log density of each stretch given the others [nat]
    k_hat: Float[np.ndarray, " block"] = field(repr=False)  # Tail index of the weights that leave it out

    @property
    def value(self) -> float:
        """Sum over the stretches [nat]."""
        return float(self.each.sum())

    @property
    def error(self) -> float:
        """Its standard error, from how the stretches differ [nat]."""
        return float(np.sqrt(len(self.each) * self.each.var(ddof=1)))

    @property
    def unreliable(self) -> int:
        """Stretches whose weights have too heavy a tail."""
        return int(np.count_nonzero(self.k_hat > GOOD_K_HAT))

    def less(self, other: LeaveOut) -> tuple[float, float]:
        """How much better this class predicts the same stretches than another."""
        gap = self.each - other.each
        return float(gap.sum()), float(np.sqrt(len(gap) * gap.var(ddof=1)))


def leave_out(posterior: Posterior, draws: Float[np.ndarray, "draw parameter"], blocks: int = BLOCKS) -> LeaveOut:
    """Cross-validate over stretches of the measurements by Pareto-smoothed importance sampling."""
    each, tails = [], []
    for index, observation in enumerate(posterior.observations):
        if not 2 <= blocks <= len(observation.values):
            raise InputError("leave_out(blocks)", f"{blocks}", f"2 to {len(observation.values)}")
        pointwise = posterior.pointwise_log_likelihood(draws, index).sum(axis=2)
        pointwise = pointwise[np.isfinite(pointwise).all(axis=1)]
        edges = np.linspace(0, pointwise.shape[1], blocks + 1).astype(int)[:-1]
        for density in np.add.reduceat(pointwise, edges, axis=1).T:
            weights, k_hat = smoothed_weights(-density)
            each.append(logsumexp(density, b=weights))
            tails.append(k_hat)
    return LeaveOut(np.array(each), np.array(tails))


@dataclass(frozen=True, eq=False)
class ModelClass:
    """What a comparison knows about one model class."""

    name: str  # Name of the class
    evidence: Evidence | None  # log Z; None where it is not known
    left_out: LeaveOut  # Predictive density by stretches
    parameters: int  # Number of parameters
    unexplained: float  # Share of the measurement's variance that its best prediction leaves unexplained
    inside: float  # Share of the measurement inside its 90 % predictive band
    trusted: bool  # Whether its draws have converged, and are certified where they rest on a surrogate


@dataclass(frozen=True, eq=False)
class Comparison(ShownAsText):
    """Model classes side by side."""

    classes: tuple[ModelClass, ...]  # At least two, of the same measurements

    def __post_init__(self) -> None:
        if len(self.classes) < 2:
            raise InputError("compare", f"{len(self.classes)} model class", "two or more")

    @property
    def by_evidence(self) -> bool:
        """Whether every class knows its evidence."""
        return all(c.evidence is not None for c in self.classes)

    @property
    def best(self) -> ModelClass:
        """The class with the most evidence, or with the most predictive density where some evidence is not known."""
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
        """Posterior probabilities of the classes from equal prior ones, shape (class,); NaN where an evidence is not known."""
        if not self.by_evidence:
            return np.full(len(self.classes), np.nan)
        values = np.array([c.evidence.value for c in self.classes if c.evidence is not None])
        return np.asarray(np.exp(values - logsumexp(values)))

    @property
    def verdict(self) -> str:
        """In a sentence."""
        best, others = self.best, sorted((c for c in self.classes if c is not self.best), key=self._score)
        second = others[-1]
        if self.by_evidence:
            gap, error = self.bayes_factor(second)
            strength = (
                "decides for"
                if -gap > 5 + 2 * error
                else "leans to"
                if -gap > 1 + 2 * error
                else "cannot choose: first is"
            )
            sentence = (
                f"The evidence {strength} {best.name}: log Bayes factor {-gap:.1f} ± {error:.1f} against {second.name}."
            )
        else:
            gap, error = second.left_out.less(best.left_out)
            sentence = (
                f"{best.name} predicts best what is left out: by {-gap:.1f} ± {error:.1f} nats against {second.name}."
            )
        doubtful = [c.name for c in self.classes if not c.trusted]
        if doubtful:
            sentence += f" Not to be relied on: {', '.join(doubtful)} not converged, or not certified."
        return sentence

    def rows(self) -> tuple[list[str], list[list[str]]]:
        """Give the figures as text."""
        heads = [
            "model class", "parameters", "log evidence", "log Bayes factor", "probability", "log density left out", "to the best",
            "unexplained", "inside 90 %",
        ]  # fmt: skip
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
        """Give the same with a column for each class, and what each row is in full."""
        _, rows = self.rows()
        meanings = [
            "parameters, those of the discrepancy included",
            "log evidence [nat]",
            "log Bayes factor against the best [nat]",
            "probability among these classes",
            "log density of the stretches left out, all together [nat]",
            "the same, less that of the best class [nat]",
            "variance that the best prediction leaves unexplained",
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
