"""Hysteretic laws compared on a test of a specimen, by evidence and by the prediction of the later part of the test."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial

import numpy as np

from structid.core.errors import ConvergenceError
from structid.core.notebook import ShownAsText
from structid.core.progress import Progress
from structid.core.wording import listed
from structid.inference.error_models.base import ErrorModel
from structid.inference.error_models.independent import IID
from structid.inference.error_models.kernels import AR1
from structid.law_choice.cyclic_test import FIRST_PART
from structid.law_choice.fit_store import FitStore, by_size
from structid.law_choice.law_fit import LawFit, errors_are_white, refine_law, search_law, without_mechanism
from structid.law_choice.specimen_test import SpecimenTest
from structid.mechanics.hysteretic_laws.base import HystereticLaw
from structid.optimize.many_starts import Minimum

log = logging.getLogger(__name__)

ERROR_MODELS: dict[str, tuple[ErrorModel, ...]] = {
    "auto": (IID(), AR1(white=0.0)),
    "iid": (IID(),),
    "ar1": (AR1(white=0.0),),
}
"""Error models under which laws are compared, by the kind in a study file."""

HOPELESS = {False: 6.0, True: 2.0}
"""Residual variance, relative to the smallest among the laws, above which a law is given up after its search.

If the residuals of the best law are noise of the sensors (True), a law with twice the variance has an error of its own."""
LOST = 25.0
"""Residual variance, relative to the smallest so far, above which the search of a law ends early."""
AS_GOOD = 1.2
"""Prediction error, relative to the smallest among the laws, up to which the evidence decides."""
WORTH_REPORTING = 0.5
"""Part of the variance that is left unexplained, below which a law is worth a message during the search."""
NEARLY_NOTHING = 0.0005
"""Part of the variance below which what is left, not what is explained, is shown: 99.96 % would be rounded to 100 %."""
DECISIVE = 5.0
"""Log evidence for a mechanism that counts as shown [nat]."""
CLOSE = 5.0
"""Difference of log evidences below which draws decide between two laws: Laplace's approximation may be wrong by as much [nat]."""
ABSENT = -1.0
"""Log evidence for a mechanism below which it counts as absent [nat]."""


@dataclass(frozen=True, eq=False)
class LawCandidate:
    """One law with one error model.

    Parameters
    ----------
    fit : LawFit
        Fit to the whole test.
    of_first : LawFit or None
        Fit to the first part of the test; None if its runs fail, or if the test cannot be divided.
    """

    fit: LawFit = field(repr=False)
    of_first: LawFit | None = field(repr=False)

    @cached_property
    def prediction_error(self) -> float:
        """Root mean square of the error on the later part of the test, predicted from the first, relative to the largest value."""
        if self.of_first is None:
            return np.inf
        error = self.fit.test.relative_error(self.of_first.residuals(self.fit.test), self.of_first.test)
        return error if np.isfinite(error) else np.inf

    @property
    def law(self) -> HystereticLaw:
        """The law."""
        return self.fit.law

    @property
    def name(self) -> str:
        """Law and error model in words."""
        errors = "AR(1) errors" if self.fit.correlated else "independent errors"
        return f"{self.law.word}, {errors}"

    @property
    def unexplained(self) -> float:
        """Residual variance of the best parameters over the variance of the measured values."""
        return self.fit.unexplained


@dataclass(frozen=True, eq=False)
class LawComparison(ShownAsText):
    """Hysteretic laws compared on a test.

    Parameters
    ----------
    test : SpecimenTest
        The test.
    candidates : tuple of LawCandidate
        Laws and error models, those with the fewest parameters first.
    dropped : dict of str to float
        Laws that were given up after the search, with the fraction of the variance that they leave unexplained.
    chosen : LawCandidate
        The chosen law and error model.
    """

    test: SpecimenTest
    candidates: tuple[LawCandidate, ...] = field(repr=False)
    dropped: dict[str, float] = field(repr=False)
    chosen: LawCandidate

    def with_candidates(self, further: Sequence[LawCandidate]) -> LawComparison:
        """Return the comparison with further candidates.

        Parameters
        ----------
        further : sequence of LawCandidate
            The candidates.

        Returns
        -------
        LawComparison
            The comparison; one of them may be the chosen law.
        """
        candidates = (*self.candidates, *further)
        return LawComparison(self.test, candidates, self.dropped, chosen_candidate(candidates))

    @property
    def rivals(self) -> list[LawCandidate]:
        """Other laws whose log evidence is close to the chosen one's, each with its better error model."""
        best: dict[str, LawCandidate] = {}
        for candidate in sorted(eligible(self.candidates), key=lambda c: c.fit.log_evidence):
            if self.chosen.fit.log_evidence - candidate.fit.log_evidence < CLOSE:
                best[candidate.law.word] = candidate
        return [candidate for word, candidate in best.items() if word != self.chosen.law.word]

    def of_law(self, word: str) -> list[LawCandidate]:
        """Return the candidates with one law.

        Parameters
        ----------
        word : str
            Name of the law.

        Returns
        -------
        list of LawCandidate
            One for every error model.
        """
        return [c for c in self.candidates if c.law.word == word]

    @cached_property
    def mechanisms(self) -> dict[str, float]:
        """What the test shows: the mechanisms of the chosen law, with the log evidence for each [nat].

        Each is the difference from a fit of the same law without the mechanism, by Laplace's approximation. If there are converged
        draws that reach the law without it, their density there gives the evidence (the ratio of Savage and Dickey).
        """
        described = self.chosen.law.parameters()
        return {described[name].mechanism: self._evidence_for(name) for name in described if described[name].mechanism}

    def _evidence_for(self, name: str) -> float:
        """Log evidence for a parameter of the chosen law that describes a mechanism."""
        fit = self.chosen.fit
        return fit.log_evidence - without_mechanism(fit, name).log_evidence

    @property
    def least_squares(self) -> float:
        """Part of the force's variance that the chosen law leaves unexplained at its least squares."""
        return self.least_squares_fit.unexplained

    @property
    def least_squares_fit(self) -> LawCandidate:
        """The chosen law with the error model that leaves least of the force's variance unexplained."""
        return min(self.of_law(self.chosen.law.word), key=lambda c: c.unexplained)

    @property
    def sentence(self) -> str:
        """The choice in sentences."""
        chosen, law = self.chosen, self.chosen.law
        left = self.least_squares
        explained = f"{1.0 - left:.1%}" if left > NEARLY_NOTHING else f"all but {100.0 * left:.2g} %"
        text = f"The test chooses the {law.title}: it explains {explained} of the variance of {self.test.quantity}."
        if np.isfinite(chosen.prediction_error):
            text += (
                f" From the first {FIRST_PART:.0%} of the {self.test.course} it predicts the rest with an error of "
                f"{chosen.prediction_error:.1%} of the largest value."
            )
        return f"{text} {self._shown} {self._left}{self._second}"

    @property
    def _second(self) -> str:
        """The law that predicts best among the others, in a sentence."""
        others = [c for c in self.candidates if c.law.word != self.chosen.law.word]
        # Another error model differs by thousands of nats, which say nothing of the laws.
        others = [c for c in others if c.fit.correlated == self.chosen.fit.correlated] or others
        if not others:
            return ""
        second = min(others, key=lambda c: (c.prediction_error, -c.fit.log_evidence))
        ahead = self.chosen.fit.log_evidence - second.fit.log_evidence
        behind = f"its log evidence is {abs(ahead):.0f} nats {'smaller' if ahead > 0.0 else 'larger'}"
        if not np.isfinite(second.prediction_error):
            return f" The next law is the {second.law.title}; {behind}."
        error = f"{second.prediction_error:.1%}"
        return f" The best other prediction is by the {second.law.title}, with an error of {error}; {behind}."

    @property
    def _shown(self) -> str:
        """The mechanisms that the test shows, and those that it does not, in a sentence."""
        shown = [words for words, gain in self.mechanisms.items() if gain > DECISIVE]
        absent = [words for words, gain in self.mechanisms.items() if gain < ABSENT]
        if not shown:
            return f"The test shows no {listed(absent, 'or')}." if absent else "The test shows none of its mechanisms."
        rest = f", and no {listed(absent, 'or')}" if absent else ""
        return f"The test shows {listed(shown)}{rest}."

    @property
    def _left(self) -> str:
        """Whether the chosen law leaves noise, or an error of its own, in a sentence."""
        if self.chosen.fit.leaves_noise:
            return "What it leaves is noise."
        correlation = self.chosen.fit.residual_correlation
        return f"What it leaves is correlated from sample to sample ({correlation:.2f}): an error of the law, or filtered noise."

    def __str__(self) -> str:
        width = max(len(c.name) for c in self.candidates)
        head = f"{''.ljust(width)}  parameters  log evidence  unexplained  prediction error"
        lines = [self.sentence, head]
        for c in sorted(self.candidates, key=lambda c: -c.fit.log_evidence):
            lines.append(
                f"{c.name.ljust(width)}{len(c.fit.fitted):12d}{c.fit.log_evidence:14.1f}{c.unexplained:13.2%}"
                f"{_share(c.prediction_error)}{'  <' if c is self.chosen else ''}"
            )
        if self.dropped:
            lines.append(
                "Given up after the search: "
                + ", ".join(f"{w} ({100.0 * v:.2g} % unexplained)" for w, v in self.dropped.items())
            )
        return "\n".join(lines)


def compare_laws(
    test: SpecimenTest,
    laws: Sequence[HystereticLaw],
    error_models: Sequence[ErrorModel],
    seed: int,
    store: FitStore,
    progress: Progress | None = None,
) -> LawComparison:
    """Fit every law from many starts, and choose one."""
    part, laws = test.searched, by_size(laws)
    minima_of: dict[HystereticLaw, list[Minimum]] = {}
    left: dict[HystereticLaw, float] = {}
    for number, law in enumerate(laws, start=1):
        least = min((minima[0].value for minima in minima_of.values() if minima), default=np.inf)
        give_up = least + 0.5 * len(part.scales) * np.log(LOST)
        minima_of[law] = store.minima(law, part, partial(search_law, part, law, seed, give_up))
        left[law] = _unexplained(part, minima_of[law])
        if left[law] < WORTH_REPORTING and minima_of[law][0].value < least - DECISIVE:
            shown = f"leaves {100.0 * left[law]:.2g} % of the variance of {test.quantity} unexplained"
            log.info("After %d of %d laws: the %s %s.", number, len(laws), law.title, shown)
        if progress is not None:
            progress(number, 2 * len(laws))
    best = min(laws, key=lambda law: left[law])
    limit = HOPELESS[bool(minima_of[best]) and errors_are_white(part, best, minima_of[best][0])] * left[best]
    kept = [law for law in laws if left[law] <= limit]
    dropped = {law.word: left[law] for law in laws if left[law] > limit}
    candidates = []
    for number, law in enumerate(kept, start=1):
        of_law = _candidates(test, law, minima_of[law], error_models, seed, store)
        if not of_law:
            dropped[law.word] = np.nan
        candidates += of_law
        if progress is not None:
            progress(len(laws) + round(number * len(laws) / len(kept)), 2 * len(laws))
    if not candidates:
        raise ConvergenceError("No law can follow the test: every run fails. Check the test's values and their units.")
    return LawComparison(test, tuple(candidates), dropped, chosen_candidate(candidates))


def _candidates(
    test: SpecimenTest,
    law: HystereticLaw,
    minima: list[Minimum],
    error_models: Sequence[ErrorModel],
    seed: int,
    store: FitStore,
) -> list[LawCandidate]:
    """Fit one law to the whole test and to its first part."""
    fits = store.fits(law, test, error_models, lambda: refine_law(test, law, minima, error_models))
    first = test.first
    of_first = fits_to_first(first, law, error_models, seed, store) if fits and first is not None else []
    return pair_fits(fits, of_first)


def pair_fits(fits: Sequence[LawFit], of_first: Sequence[LawFit]) -> list[LawCandidate]:
    """Return candidates from the fits to a test under every error model, and those to its first part if there are any."""
    if not of_first:
        return [LawCandidate(fit, None) for fit in fits]
    return [LawCandidate(fit, part) for fit, part in zip(fits, of_first, strict=True)]


def fits_to_first(
    first: SpecimenTest, law: HystereticLaw, error_models: Sequence[ErrorModel], seed: int, store: FitStore
) -> list[LawFit]:
    """Return the fits of a law to the first part of a test, found without its later part."""
    minima = minima_of_first(first, law, seed, store)
    return store.fits(law, first, error_models, lambda: refine_law(first, law, minima, error_models))


def minima_of_first(first: SpecimenTest, law: HystereticLaw, seed: int, store: FitStore) -> list[Minimum]:
    """Return the minima of a search in the first part of a test."""
    return store.minima(law, first.searched, lambda: search_law(first.searched, law, seed))


def chosen_candidate(candidates: Sequence[LawCandidate]) -> LawCandidate:
    """Return the candidate of largest evidence among those that leave only noise, or predict nearly as well as the best."""
    return max(eligible(candidates), key=lambda c: c.fit.log_evidence)


def eligible(candidates: Sequence[LawCandidate]) -> list[LawCandidate]:
    """Return the candidates that leave only noise, or if there is none, those that predict nearly as well as the best.

    A law that leaves only noise of the sensors may predict badly from a part of the test that does not show all of its parameters.
    """
    if noise := [c for c in candidates if c.fit.leaves_noise]:
        return noise
    best = min(c.prediction_error for c in candidates)
    return [c for c in candidates if c.prediction_error <= AS_GOOD * best]


def _unexplained(test: SpecimenTest, minima: list[Minimum]) -> float:
    """Return the residual variance at the best minimum over the variance of the measured values."""
    if not minima:
        return np.inf
    variances = [np.var(sensor.values / sensor.largest) for sensor in test.sensors]
    return float(np.mean(minima[0].mean_squares / variances))


def _share(error: float) -> str:
    """Return a prediction error as a cell of the table."""
    return f"{error:18.2%}" if np.isfinite(error) else f"{'–':>18}"
