"""Choice of the hysteretic law of a specimen from its cyclic test, by evidence and by held-out half-cycles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from jaxtyping import Float

from structid.core.errors import ConvergenceError, InputError
from structid.core.notebook import ShownAsText
from structid.core.progress import Progress
from structid.core.validation import check_arguments
from structid.inference.error_models.base import ErrorModel
from structid.inference.error_models.independent import IID
from structid.inference.error_models.kernels import AR1
from structid.inference.sampling_result import SamplingResult
from structid.law_choice.cyclic_test import CyclicTest
from structid.law_choice.law_fit import LawFit, refine_law, search_law, without_mechanism
from structid.mechanics.hysteretic_laws.base import HystereticLaw
from structid.mechanics.hysteretic_laws.law_list import LAWS, law_of
from structid.optimize.many_starts import Minimum

FIRST_PART = 0.7
"""Share of the half-cycles from which the others are predicted."""
HOPELESS = 6.0
"""Residual variance, relative to the smallest among the laws, above which a law is not fitted with further error models."""
AS_GOOD = 1.2
"""Prediction error, relative to the smallest among the laws, up to which the evidence decides."""
DECISIVE = 5.0
"""Log evidence for a mechanism that counts as shown [nat]."""


@dataclass(frozen=True, eq=False)
class LawCandidate:
    """One law with one error model.

    Parameters
    ----------
    fit : LawFit
        Fit to the whole test.
    prediction_error : float
        Root mean square of the error on the last half-cycles, predicted from the first, relative to the largest force.
    """

    fit: LawFit = field(repr=False)
    prediction_error: float

    @property
    def law(self) -> HystereticLaw:
        """The law."""
        return self.fit.law

    @property
    def name(self) -> str:
        """Law and error model in words."""
        errors = "AR(1) errors" if self.fit.correlation else "independent errors"
        return f"{self.law.word}, {errors}"

    @cached_property
    def unexplained(self) -> float:
        """Residual variance of the best parameters over the variance of the force."""
        return self.fit.test.unexplained(self.fit.force())


@dataclass(frozen=True, eq=False)
class LawChoice(ShownAsText):
    """Hysteretic laws compared on a cyclic test.

    Parameters
    ----------
    test : CyclicTest
        The test.
    candidates : tuple of LawCandidate
        Laws and error models, those with the fewest parameters first.
    dropped : dict of str to float
        Laws that were given up after the search, with the fraction of the force's variance that they leave unexplained.
    result : SamplingResult
        Draws of the posterior of the chosen law.
    chosen : LawCandidate
        The chosen law and error model.
    """

    test: CyclicTest
    candidates: tuple[LawCandidate, ...] = field(repr=False)
    dropped: dict[str, float] = field(repr=False)
    chosen: LawCandidate
    result: SamplingResult = field(repr=False)

    @cached_property
    def mechanisms(self) -> dict[str, float]:
        """What the test shows: the mechanisms of the chosen law, with the log evidence for each [nat].

        Each is the difference from the same law without the mechanism, by Laplace's approximation.
        """
        fit = self.chosen.fit
        gains = {}
        for name, described in fit.law.parameters().items():
            if described.mechanism:
                gains[described.mechanism] = fit.log_evidence - without_mechanism(fit, name).log_evidence
        return gains

    @property
    def least_squares(self) -> float:
        """Part of the force's variance that the chosen law leaves unexplained at its least squares."""
        same = [c.unexplained for c in self.candidates if c.law.word == self.chosen.law.word]
        return min(same)

    @property
    def sentence(self) -> str:
        """The choice in sentences."""
        chosen, law = self.chosen, self.chosen.law
        others = [c for c in self.candidates if c.law.word != law.word]
        text = (
            f"The test chooses the {law.title}: it explains {1.0 - self.least_squares:.1%} of the variance of the force. From the "
            f"first {FIRST_PART:.0%} of the half-cycles it predicts the others with an error of {chosen.prediction_error:.1%} of "
            "the largest force."
        )
        if not others:
            return text
        second = min(others, key=lambda c: c.prediction_error)
        ahead = chosen.fit.log_evidence - max(c.fit.log_evidence for c in others if c.law.word == second.law.word)
        relation = "smaller" if ahead > 0.0 else "larger"
        return (
            f"{text} {self._shown} The best other prediction is by {second.law.word}, with an error of "
            f"{second.prediction_error:.1%}; its log evidence is {abs(ahead):.0f} nats {relation}."
        )

    @property
    def _shown(self) -> str:
        """The mechanisms that the test shows, and those that it does not, in a sentence."""
        shown = [words for words, gain in self.mechanisms.items() if gain > DECISIVE]
        absent = [words for words, gain in self.mechanisms.items() if gain < -1.0]
        text = f"The test shows {_listed(shown)}" if shown else "The test shows none of its further mechanisms"
        return f"{text}, and no {_listed(absent, 'or')}." if absent else f"{text}."

    def __str__(self) -> str:
        width = max(len(c.name) for c in self.candidates)
        head = f"{''.ljust(width)}  parameters  log evidence  unexplained  prediction error"
        lines = [self.sentence, head]
        for c in sorted(self.candidates, key=lambda c: -c.fit.log_evidence):
            lines.append(
                f"{c.name.ljust(width)}{len(c.fit.model.free):12d}{c.fit.log_evidence:14.1f}{c.unexplained:13.2%}"
                f"{c.prediction_error:18.2%}{'  <' if c is self.chosen else ''}"
            )
        if self.dropped:
            lines.append(
                "Given up after the search: " + ", ".join(f"{w} ({v:.0%} unexplained)" for w, v in self.dropped.items())
            )
        return "\n".join(lines)


@check_arguments
def choose_model(
    test: CyclicTest,
    laws: Sequence[str | HystereticLaw] | None = None,
    error_models: Sequence[ErrorModel] = (IID(), AR1(white=0.0)),
    *,
    seed: int = 0,
    progress: Progress | None = None,
) -> LawChoice:
    """Choose the hysteretic law of a specimen from its cyclic test.

    Every law is fitted from many starts with its default priors for the test, to all half-cycles and to the first 70 % of them.
    Among the laws that predict the last half-cycles nearly as well as the best, the evidence decides. The posterior of the chosen
    law is sampled.

    Parameters
    ----------
    test : CyclicTest
        The test.
    laws : sequence of str or HystereticLaw, optional
        The laws to choose among; by default all except the linear spring.
    error_models : sequence of ErrorModel
        `IID()`, `AR1(white=0.0)`, or both.
    seed : int
        Seed.
    progress : callable, optional
        Called with the number of laws done and their total.

    Returns
    -------
    LawChoice
        ``print`` shows the comparison; ``.result`` has the draws.

    Raises
    ------
    InputError
        If there is no law, or an error model is of another type.
    ConvergenceError
        If the runs of every law fail.

    Examples
    --------
    >>> import structid as si
    >>> choice = si.choose_model(test)  # doctest: +SKIP
    >>> choice.result.summary()  # doctest: +SKIP
    """
    candidates_of = [law_of("choose_model(laws)", law) for law in (laws if laws is not None else list(LAWS)[1:])]
    if not candidates_of:
        raise InputError("choose_model(laws)", "no law", f"one or more of {', '.join(LAWS)}")
    for errors in error_models:
        given = errors.describe()
        if given["kind"] != "iid" and not (given["kind"] == "ar1" and given.get("white") == 0.0):
            raise InputError("choose_model(error_models)", f"{type(errors).__name__}", "IID() and AR1(white=0.0)")
    first = test.part(slice(0, test.until(FIRST_PART)))
    ladder = sorted(candidates_of, key=lambda law: len(law.parameters()))
    searched: list[tuple[HystereticLaw, list[Minimum], float]] = []
    for number, law in enumerate(ladder, start=1):
        minima = search_law(test, law, seed)
        searched.append((law, minima, _unexplained(test, minima)))
        if progress is not None:
            progress(number, 2 * len(ladder))
    least = min(unexplained for _, _, unexplained in searched)
    kept = [(law, minima) for law, minima, unexplained in searched if unexplained <= HOPELESS * least]
    dropped = {law.word: unexplained for law, _, unexplained in searched if unexplained > HOPELESS * least}
    candidates = []
    for number, (law, minima) in enumerate(kept, start=1):
        of_first = search_law(first, law, seed)
        fits = refine_law(test, law, minima, error_models)
        if not fits:
            dropped[law.word] = np.nan
            continue
        of_the_first = refine_law(first, law, of_first, error_models)
        failed = [np.full(len(test.force), np.nan)] * len(fits)
        for fit, predicted in zip(fits, [f.force(test) for f in of_the_first] or failed, strict=True):
            candidates.append(LawCandidate(fit, _prediction_error(test, predicted, len(first.force))))
        if progress is not None:
            progress(len(ladder) + round(number * len(ladder) / len(kept)), 2 * len(ladder))
    if not candidates:
        raise ConvergenceError(
            "No law can follow the path of the test: every run fails. Check the test's displacements."
        )
    chosen = _chosen(candidates)
    return LawChoice(test, tuple(candidates), dropped, chosen, chosen.fit.sampled(seed))


def _chosen(candidates: list[LawCandidate]) -> LawCandidate:
    """Return the candidate of largest evidence among those that predict nearly as well as the best."""
    best = min(c.prediction_error for c in candidates)
    return max((c for c in candidates if c.prediction_error <= AS_GOOD * best), key=lambda c: c.fit.log_evidence)


def _unexplained(test: CyclicTest, minima: list[Minimum]) -> float:
    """Return the residual variance at the best minimum over the variance of the force."""
    return minima[0].mean_square / float(np.var(test.force / test.largest_force)) if minima else np.inf


def _prediction_error(test: CyclicTest, force: Float[np.ndarray, " time"], first: int) -> float:
    """Return the root mean square error after the first samples, relative to the largest force; inf for a failed run."""
    error = float(np.sqrt(np.mean((test.force - force)[first:] ** 2)) / test.largest_force)
    return error if np.isfinite(error) else np.inf


def _listed(words: list[str], last: str = "and") -> str:
    """Return words as a list in a sentence."""
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} {last} {words[-1]}"
