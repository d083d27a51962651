"""Choice of the hysteretic law of a specimen from its cyclic test, by evidence and by held-out half-cycles."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
import scipy.special
from jaxtyping import Float

from structid.core.errors import ConvergenceError, InputError
from structid.core.hashing import digest
from structid.core.notebook import ShownAsText
from structid.core.progress import Progress
from structid.core.streams import Purpose, stream
from structid.core.validation import check_arguments
from structid.inference.error_models.base import ErrorModel
from structid.inference.error_models.independent import IID
from structid.inference.error_models.kernels import AR1
from structid.inference.sampling_result import SamplingResult
from structid.law_choice.cyclic_test import FEWEST, CyclicTest
from structid.law_choice.extrapolation import (
    FIRST_PART,
    ORIGINS,
    TO_ALL,
    TO_FIRST_PART,
    CyclicPrediction,
    LawOnParts,
    average_prediction,
    weights_by_prediction,
)
from structid.law_choice.fit_store import FitStore
from structid.law_choice.law_fit import LawFit, refine_law, search_law, without_mechanism
from structid.mechanics.hysteretic_laws.base import HystereticLaw
from structid.mechanics.hysteretic_laws.law_list import LAWS, law_of
from structid.models.hysteretic.hysteretic import Hysteretic
from structid.optimize.many_starts import Minimum

HOPELESS = 6.0
"""Residual variance, relative to the smallest among the laws, above which a law is not fitted with further error models."""
AS_GOOD = 1.2
"""Prediction error, relative to the smallest among the laws, up to which the evidence decides."""
DECISIVE = 5.0
"""Log evidence for a mechanism that counts as shown [nat]."""
ABSENT = -1.0
"""Log evidence for a mechanism below which it counts as absent [nat]."""
LITTLE = 0.8
"""Posterior standard deviation, relative to the prior's, above which a parameter counts as not identified."""
SMALLEST = 1e-15
"""Smallest probability of a tail."""
FITS, DRAWS_OF_LAW = "laws.journal", "chains.h5"
"""Files of the fitted laws and of the draws."""
DRAWS = 1000
"""Number of draws of a predicted force."""


@dataclass(frozen=True, eq=False)
class LawCandidate:
    """One law with one error model.

    Parameters
    ----------
    fit : LawFit
        Fit to the whole test.
    of_first : LawFit or None
        Fit to the first half-cycles; None if its runs fail, or if the test has no further half-cycles.
    """

    fit: LawFit = field(repr=False)
    of_first: LawFit | None = field(repr=False)

    @cached_property
    def prediction_error(self) -> float:
        """Root mean square of the error on the last half-cycles, predicted from the first, relative to the largest force."""
        if self.of_first is None:
            return np.inf
        test, first = self.fit.test, len(self.of_first.test.force)
        error = float(np.sqrt(np.mean((test.force - self.of_first.force(test))[first:] ** 2)) / test.largest_force)
        return error if np.isfinite(error) else np.inf

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
    chosen : LawCandidate
        The chosen law and error model.
    result : SamplingResult
        Draws of the posterior of the chosen law.
    on_parts : tuple of LawOnParts
        The laws, with every error model, fitted to parts of the test; predictions are averaged over them.
    """

    test: CyclicTest
    candidates: tuple[LawCandidate, ...] = field(repr=False)
    dropped: dict[str, float] = field(repr=False)
    chosen: LawCandidate
    result: SamplingResult = field(repr=False)
    on_parts: tuple[LawOnParts, ...] = field(repr=False, default=())

    @cached_property
    def weights(self) -> dict[str, float]:
        """Weights of the laws in a prediction, by how well they predict later half-cycles of the test from earlier ones."""
        return self._by_law(self._weights_to_all)

    @cached_property
    def _weights_to_all(self) -> Float[np.ndarray, " member"]:
        return weights_by_prediction(self.on_parts, TO_ALL)

    @cached_property
    def evidence_weights(self) -> dict[str, float]:
        """Posterior probabilities of the laws, with equal prior probabilities; one law takes nearly all in most tests."""
        evidence = np.array([law.fits[TO_ALL].log_evidence for law in self.on_parts])
        weights = np.exp(evidence - evidence.max())
        return self._by_law(weights / weights.sum())

    def _by_law(self, weights: Float[np.ndarray, " member"]) -> dict[str, float]:
        total = dict.fromkeys((law.word for law in self.on_parts), 0.0)
        for law, weight in zip(self.on_parts, weights, strict=True):
            total[law.word] += float(weight)
        return total

    def _of_law(self, word: str) -> list[LawCandidate]:
        return [c for c in self.candidates if c.law.word == word]

    @cached_property
    def held_out(self) -> CyclicPrediction:
        """The force of the whole test, predicted from its first half-cycles by the average of the laws."""
        return self._averaged(TO_FIRST_PART, self.test)

    def predict(self, displacement: Float[np.ndarray, " time"]) -> CyclicPrediction:
        """Predict the force of the specimen under other displacements, by the average of the laws.

        The band contains the error of the model. It grows with the largest and the cumulative displacement beyond those of the
        test, as much as in the predictions of later half-cycles of the test from earlier ones.

        Parameters
        ----------
        displacement : ndarray, shape (time,)
            Displacements of a specimen without damage [m].

        Returns
        -------
        CyclicPrediction
            Draws of the force, its mean and its band.

        Raises
        ------
        InputError
            If the test has too few half-cycles to show the error of the model.
        ConvergenceError
            If the runs of every law fail along the path.

        Examples
        --------
        >>> prediction = choice.predict(1.5 * test.displacement)  # doctest: +SKIP
        >>> low, high = prediction.band(0.9)  # doctest: +SKIP
        """
        return self._averaged(TO_ALL, self.test.along(displacement))

    def _averaged(self, last: int, along: CyclicTest) -> CyclicPrediction:
        """Return the prediction by one of the fits of every law."""
        if not self.on_parts:
            raise InputError(
                "LawChoice",
                "no law was fitted to parts of the test",
                "a test with three or more half-cycles",
                "Simulate choice.chosen.fit.model; the error of the model is unknown.",
            )
        rng = stream(self.result.seed, Purpose.HYSTERETIC_LAW)
        weights = self._weights_to_all if last == TO_ALL else weights_by_prediction(self.on_parts, last)
        return average_prediction(self.on_parts, weights, last, along, DRAWS, rng)

    def oscillator(
        self, mass: float, damping_ratio: float = 0.0, channels: tuple[str, ...] = ("displacement",)
    ) -> Hysteretic:
        """Return an oscillator whose spring is the specimen with the chosen law.

        Parameters
        ----------
        mass : float
            Mass [kg].
        damping_ratio : float
            Viscous damping ratio, in addition to the energy that the law dissipates.
        channels : tuple of str
            Recorded channels.

        Returns
        -------
        Hysteretic
            The model; its free parameters are the law's, in the order of `result`.

        Examples
        --------
        >>> oscillator = choice.oscillator(12e3, 0.02)  # doctest: +SKIP
        >>> draws = choice.result.flat[:100, : len(oscillator.free)]  # doctest: +SKIP
        >>> responses = oscillator.simulate(draws, record)  # doctest: +SKIP
        """
        fit = self.chosen.fit
        return Hysteretic(fit.law, mass=mass, damping_ratio=damping_ratio, free=fit.model.free, channels=channels)

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

    @cached_property
    def unidentified(self) -> tuple[str, ...]:
        """Parameters of the chosen law whose posterior is nearly as wide as their prior."""
        names, space = self.chosen.fit.model.free, self.test.priors(self.chosen.law)
        # In coordinates in which every prior is a standard normal distribution
        scores = scipy.special.ndtri(space.cdf(self.result.flat[:, : len(names)]).clip(SMALLEST, 1.0 - SMALLEST))
        return tuple(name for name, sd in zip(names, scores.std(axis=0), strict=True) if sd > LITTLE)

    @property
    def least_squares(self) -> float:
        """Part of the force's variance that the chosen law leaves unexplained at its least squares."""
        return self.least_squares_fit.unexplained

    @property
    def least_squares_fit(self) -> LawCandidate:
        """The chosen law with the error model that leaves least of the force's variance unexplained."""
        return min(self._of_law(self.chosen.law.word), key=lambda c: c.unexplained)

    @property
    def sentence(self) -> str:
        """The choice in sentences."""
        chosen, law = self.chosen, self.chosen.law
        others = [c for c in self.candidates if c.law.word != law.word]
        text = f"The test chooses the {law.title}: it explains {1.0 - self.least_squares:.1%} of the variance of the force."
        if np.isfinite(chosen.prediction_error):
            text += (
                f" From the first {FIRST_PART:.0%} of the half-cycles it predicts the others with an error of "
                f"{chosen.prediction_error:.1%} of the largest force."
            )
        text = f"{text} {self._shown}"
        if not others:
            return text
        second = min(others, key=lambda c: (c.prediction_error, -c.fit.log_evidence))
        ahead = chosen.fit.log_evidence - max(c.fit.log_evidence for c in others if c.law.word == second.law.word)
        relation = "smaller" if ahead > 0.0 else "larger"
        if not np.isfinite(second.prediction_error):
            return (
                f"{text} The next law is the {second.law.title}; its log evidence is {abs(ahead):.0f} nats {relation}."
            )
        return (
            f"{text} The best other prediction is by the {second.law.title}, with an error of "
            f"{second.prediction_error:.1%}; its log evidence is {abs(ahead):.0f} nats {relation}."
        )

    @property
    def _shown(self) -> str:
        """The mechanisms that the test shows, and those that it does not, in a sentence."""
        shown = [words for words, gain in self.mechanisms.items() if gain > DECISIVE]
        absent = [words for words, gain in self.mechanisms.items() if gain < ABSENT]
        text = f"The test shows {_listed(shown)}" if shown else "The test shows none of its further mechanisms"
        return f"{text}, and no {_listed(absent, 'or')}." if absent else f"{text}."

    def __str__(self) -> str:
        width = max(len(c.name) for c in self.candidates)
        head = f"{''.ljust(width)}  parameters  log evidence  unexplained  prediction error"
        lines = [self.sentence, head]
        for c in sorted(self.candidates, key=lambda c: -c.fit.log_evidence):
            lines.append(
                f"{c.name.ljust(width)}{len(c.fit.model.free):12d}{c.fit.log_evidence:14.1f}{c.unexplained:13.2%}"
                f"{_share(c.prediction_error)}{'  <' if c is self.chosen else ''}"
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
    folder: str | os.PathLike[str] | None = None,
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
    folder : path-like, optional
        Folder for the fits and the draws: an interrupted choice continues there, with identical results.
    progress : callable, optional
        Called with the amount done and the total.

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
    ladder = sorted(candidates_of, key=lambda law: len(law.parameters()))
    store = FitStore(None if folder is None else Path(folder) / FITS, _identity(test, ladder, error_models, seed))
    searched: list[tuple[HystereticLaw, list[Minimum], float]] = []
    for number, law in enumerate(ladder, start=1):
        minima = store.minima(law, test, partial(search_law, test, law, seed))
        searched.append((law, minima, _unexplained(test, minima)))
        if progress is not None:
            progress(number, 2 * len(ladder))
    least = min(unexplained for _, _, unexplained in searched)
    kept = [(law, minima) for law, minima, unexplained in searched if unexplained <= HOPELESS * least]
    dropped = {law.word: unexplained for law, _, unexplained in searched if unexplained > HOPELESS * least}
    candidates, on_parts = [], []
    for number, (law, minima) in enumerate(kept, start=1):
        of_law, parts = _fitted(test, law, minima, error_models, seed, store)
        if not of_law:
            dropped[law.word] = np.nan
        candidates += of_law
        on_parts += parts
        if progress is not None:
            progress(len(ladder) + round(number * len(ladder) / len(kept)), 2 * len(ladder))
    if not candidates:
        raise ConvergenceError(
            "No law can follow the path of the test: every run fails. Check the test's displacements."
        )
    chosen = _chosen(candidates)
    draws = chosen.fit.sampled(seed, None if folder is None else Path(folder) / DRAWS_OF_LAW)
    return LawChoice(test, tuple(candidates), dropped, chosen, draws, tuple(on_parts))


def _identity(
    test: CyclicTest, laws: Sequence[HystereticLaw], error_models: Sequence[ErrorModel], seed: int
) -> dict[str, Any]:
    """Return all on which the fits depend."""
    priors = [test.priors(law).content_hash for law in laws]
    return {
        "test": digest([test.displacement, test.force]),
        "laws": [
            f"{law.word} {digest([dataclasses.asdict(law), prior])}" for law, prior in zip(laws, priors, strict=True)
        ],
        "error_models": digest([errors.describe() for errors in error_models]),
        "seed": seed,
    }


def _fitted(
    test: CyclicTest,
    law: HystereticLaw,
    minima: list[Minimum],
    error_models: Sequence[ErrorModel],
    seed: int,
    store: FitStore,
) -> tuple[list[LawCandidate], list[LawOnParts]]:
    """Fit one law to the whole test, to its first part, and to shorter parts."""

    def fits_to(part: CyclicTest, starts: list[Minimum]) -> list[LawFit]:
        return store.fits(law, part, error_models, lambda: refine_law(part, law, starts, error_models))

    fits = fits_to(test, minima)
    if not fits:
        return [], []
    first = test.part(slice(0, test.until(FIRST_PART)))
    if len(first.force) == len(test.force):
        return [LawCandidate(fit, None) for fit in fits], []
    searched = store.minima(law, first, lambda: search_law(first, law, seed))
    of_first = fits_to(first, searched)
    if not of_first:
        return [LawCandidate(fit, None) for fit in fits], []
    ends = sorted({test.until(share) for share in ORIGINS} - {len(first.force)})
    shorter = [test.part(slice(0, end)) for end in ends if end >= FEWEST]
    earlier = [fits_to(part, [of_first[0].minimum, *searched[1:]]) for part in shorter]
    candidates = [LawCandidate(fit, part) for fit, part in zip(fits, of_first, strict=True)]
    if not all(earlier):
        return candidates, []
    return candidates, [LawOnParts(test, of_model) for of_model in zip(*earlier, of_first, fits, strict=True)]


def _chosen(candidates: list[LawCandidate]) -> LawCandidate:
    """Return the candidate of largest evidence among those that predict nearly as well as the best."""
    best = min(c.prediction_error for c in candidates)
    return max((c for c in candidates if c.prediction_error <= AS_GOOD * best), key=lambda c: c.fit.log_evidence)


def _unexplained(test: CyclicTest, minima: list[Minimum]) -> float:
    """Return the residual variance at the best minimum over the variance of the force."""
    return minima[0].mean_square / float(np.var(test.force / test.largest_force)) if minima else np.inf


def _share(error: float) -> str:
    """Return a prediction error as a cell of the table."""
    return f"{error:18.2%}" if np.isfinite(error) else f"{'–':>18}"


def _listed(words: list[str], last: str = "and") -> str:
    """Return words as a list in a sentence."""
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} {last} {words[-1]}"
