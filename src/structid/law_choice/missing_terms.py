"""Terms of the force that a law lacks, sought in the residuals of its fit to a cyclic test.

Terms are added one by one, each the one that leaves least in half-cycles that take no part in its fit (forward selection with
cross-validation; neighbouring residuals are far from independent, half-cycles nearly so).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.special
from jaxtyping import Float, Int

from structid.inference.error_models.base import ErrorModel
from structid.law_choice.cyclic_test import FIRST_PART, CyclicTest
from structid.law_choice.fit_store import FitStore
from structid.law_choice.law_comparison import LawCandidate, pair_fits
from structid.law_choice.law_fit import LawFit, refine_law
from structid.mechanics.hysteretic_laws.added_terms import TERMS, SpringState, law_with_terms, states_along
from structid.mechanics.hysteretic_laws.base import HystereticLaw
from structid.optimize.many_starts import Minimum

MOST_TERMS = 2
"""Largest number of terms; on ten real tests a third one seldom held in later half-cycles."""
FEWEST_PARTS = 6
"""Smallest number of half-cycles in which terms are sought."""
SHOWN = 2.0
"""Gain of a term in the half-cycles, in standard errors, that it needs to be added."""
LEAST = 0.03
"""Part of the residual variance that it must explain."""
SMALLEST = 1e-15
"""Smallest probability of a tail of a coefficient's prior."""
TINY = 1e-9
"""Regularisation of the normal equations, for terms that are zero in most half-cycles."""
HOLDS = 0.05
"""Part of the residual variance of the later half-cycles that terms must explain to hold there."""


@dataclass(frozen=True, eq=False)
class MissingTerms:
    """Terms of the force that the chosen law lacks.

    Parameters
    ----------
    law : HystereticLaw
        The law without the terms.
    names : tuple of str
        Formulas of the terms, in the state of the spring relative to the largest displacement and force of the test; empty if the
        residuals show none.
    coefficients : ndarray, shape (term,)
        Coefficients by least squares [N].
    residuals : ndarray, shape (time,)
        Force that the law leaves unexplained [N].
    added : ndarray, shape (time,)
        Force of the terms [N].
    start : int
        First sample that the search for terms did not use; the number of samples if it used all.
    scales : tuple of float
        Largest displacement [m] and force [N] of the test.
    """

    law: HystereticLaw
    names: tuple[str, ...]
    coefficients: np.ndarray
    residuals: np.ndarray
    added: np.ndarray
    start: int
    scales: tuple[float, float]

    @property
    def extended(self) -> HystereticLaw:
        """The law with the terms, whose coefficients are parameters; it can be given to `choose_model`."""
        return law_with_terms(self.law, self.names, self.scales)

    @property
    def explained(self) -> float:
        """Part of the residual variance that the terms explain where they were sought."""
        return _explained(self.residuals[: self.start], self.added[: self.start])

    @property
    def explained_later(self) -> float:
        """Part of the residual variance of the later half-cycles, which they predict; negative if they make it larger."""
        if self.start == len(self.residuals):
            return float("nan")
        return _explained(self.residuals[self.start :], self.added[self.start :])

    @property
    def holds(self) -> bool:
        """Whether the terms also explain a part of the later half-cycles."""
        return bool(self.names) and self.explained_later > HOLDS

    @property
    def sentence(self) -> str:
        """What the law lacks, in sentences."""
        if not self.names:
            return (
                f"What the {self.law.title} leaves of the force follows no function of displacement, direction, force, peak and "
                "absorbed energy."
            )
        meanings = "; ".join(f"{TERMS[name].meaning} ({name})" for name in self.names)
        where = f"the first {FIRST_PART:.0%} of the half-cycles" if self.start < len(self.residuals) else "the test"
        text = f"The {self.law.title} lacks: {meanings}. In {where}, this explains {self.explained:.0%} of what the law leaves"
        if self.start == len(self.residuals):
            return f"{text}."
        if self.holds:
            return f"{text}. With the same coefficients, it explains {self.explained_later:.0%} of it in the rest."
        return f"{text}, but nothing in the rest: it does not hold beyond the displacements at which it was found."

    def __str__(self) -> str:
        return self.sentence


def find_missing_terms(test: CyclicTest, candidate: LawCandidate) -> MissingTerms:
    """Seek terms that a law lacks, in the first part of a test if the law was fitted to it."""
    fit = candidate.of_first or candidate.fit
    start = len(fit.test.scales)
    residuals = fit.residuals(test)
    scales = (test.largest_displacement, test.largest_force)
    states = states_along(test.displacement, test.force - residuals, scales)
    names: list[str] = []
    if np.isfinite(residuals).all():
        turns = test.turns[test.turns < start]
        names = _selected(SpringState(*(values[:start] for values in states)), residuals[:start], turns)
    matrix = _matrix(names, states)
    coefficients = np.linalg.lstsq(matrix[:start], residuals[:start], rcond=None)[0]
    return MissingTerms(fit.law, tuple(names), coefficients, residuals, matrix @ coefficients, start, scales)


def candidates_with_terms(
    chosen: LawCandidate, missing: MissingTerms, error_models: Sequence[ErrorModel], store: FitStore
) -> list[LawCandidate]:
    """Fit the chosen law with further terms, from its own best parameters and those of the terms."""
    law = missing.extended

    def fits_to(fit: LawFit) -> list[LawFit]:
        space, known = fit.test.unknowns(law), dict(zip(fit.fitted, fit.minimum.x, strict=True))
        without = np.array([known.get(name, 0.0) for name in space.names])
        starts = np.stack([without, without])
        for number, coefficient in enumerate(missing.coefficients, start=1):
            name = f"term_{number}"
            probability = space.marginals[name].cdf(np.array([coefficient]))[0].clip(SMALLEST, 1.0 - SMALLEST)
            starts[1, space.names.index(name)] = scipy.special.ndtri(probability)
        minima = [Minimum(x, fit.minimum.value, fit.minimum.mean_squares, np.eye(len(x))) for x in starts]
        return store.fits(law, fit.test, error_models, lambda: refine_law(fit.test, law, minima, error_models))

    fits = fits_to(chosen.fit)
    of_first = fits_to(chosen.of_first) if fits and chosen.of_first is not None else []
    return pair_fits(fits, of_first)


def _selected(states: SpringState, residuals: Float[np.ndarray, " time"], turns: Int[np.ndarray, " turn"]) -> list[str]:
    """Return the terms that residuals show, the one that explains most first."""
    parts = [part for part in np.split(np.arange(len(residuals)), turns) if len(part)]
    library, names = _matrix(tuple(TERMS), states), list(TERMS)
    chosen: list[int] = []
    left = np.array([np.sum(residuals[part] ** 2) for part in parts])
    while len(chosen) < MOST_TERMS and len(parts) >= FEWEST_PARTS:
        free = [i for i in range(len(names)) if i not in chosen]
        after = [_squares_left_out(library[:, [*chosen, i]], residuals, parts) for i in free]
        best = int(np.argmin([squares.sum() for squares in after]))
        gains = left - after[best]
        if gains.sum() < SHOWN * np.std(gains) * np.sqrt(len(gains)) or gains.sum() < LEAST * left.sum():
            break
        chosen.append(free[best])
        left = after[best]
    return [names[i] for i in chosen]


def _squares_left_out(
    matrix: Float[np.ndarray, "time term"], y: Float[np.ndarray, " time"], parts: Sequence[np.ndarray]
) -> Float[np.ndarray, " part"]:
    """Return the sum of squares of every part after a regression on the others."""
    products = [(matrix[part].T @ matrix[part], matrix[part].T @ y[part]) for part in parts]
    whole = sum(a for a, _ in products) + TINY * np.eye(matrix.shape[1]), sum(b for _, b in products)
    return np.array(
        [
            np.sum((y[part] - matrix[part] @ np.linalg.solve(whole[0] - a, whole[1] - b)) ** 2)
            for part, (a, b) in zip(parts, products, strict=True)
        ]
    )


def _matrix(names: Sequence[str], states: SpringState) -> Float[np.ndarray, "time term"]:
    """Return the values of terms along a path."""
    if not names:
        return np.zeros((len(states.u), 0))
    return np.stack([TERMS[name].value(states) for name in names], axis=1)


def _explained(residuals: Float[np.ndarray, " time"], added: Float[np.ndarray, " time"]) -> float:
    return float(1.0 - np.sum((residuals - added) ** 2) / np.sum(residuals**2))
