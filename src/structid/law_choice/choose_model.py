"""Choice of the hysteretic law of a specimen from a test, with its posterior and predictions of further tests."""

from __future__ import annotations

import dataclasses
import logging
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from pathlib import Path

import numpy as np
import scipy.special
from jaxtyping import Float

from structid.core.errors import InputError
from structid.core.progress import Progress
from structid.core.streams import Purpose, stream
from structid.core.validation import check_arguments
from structid.core.wording import listed
from structid.inference.error_models.base import ErrorModel
from structid.inference.sampling_result import SamplingResult
from structid.law_choice.cyclic_test import FEWEST, CyclicTest
from structid.law_choice.extrapolation import (
    ORIGINS,
    TO_ALL,
    TO_FIRST_PART,
    CyclicPrediction,
    LawOnParts,
    average_prediction,
    weights_by_prediction,
)
from structid.law_choice.fit_store import FitStore
from structid.law_choice.law_comparison import ERROR_MODELS, LawCandidate, LawComparison, compare_laws, minima_of_first
from structid.law_choice.law_fit import refine_law
from structid.law_choice.missing_terms import MissingTerms, candidates_with_terms, find_missing_terms
from structid.law_choice.motion_test import MotionTest
from structid.law_choice.savage_dickey import log_evidence_by_draws
from structid.mechanics.hysteretic_laws.base import HystereticLaw
from structid.mechanics.hysteretic_laws.law_list import INELASTIC, LAWS, law_of
from structid.models.hysteretic.hysteretic import Hysteretic

log = logging.getLogger(__name__)

LITTLE = 0.8
"""Posterior standard deviation, relative to the prior's, above which a parameter counts as not identified."""
SHOWN_WEIGHT = 0.005
"""Weight of a law in a prediction from which it is named."""
SMALLEST = 1e-15
"""Smallest probability of a tail."""
DRAWS_OF_LAW = "chains.h5"
"""File of the draws in a folder."""
DRAWS = 1000
"""Number of draws of a predicted force."""
MISSED = 5.0
"""Error of Laplace's log evidence [nats] from which the normal approximation misses the posterior."""
LITTLE_WEIGHT = 0.05
"""Weight in the prediction from the first part from which a law is sampled there, too."""
RUNS_FOR_FIRST = 2
"""Tempering runs for the posterior of the first part: its draws show a spread, and no evidence."""


@dataclass(frozen=True, eq=False)
class LawChoice(LawComparison):
    """The chosen hysteretic law of a specimen, the laws compared with it, and its posterior.

    Parameters
    ----------
    test : CyclicTest or MotionTest
        The test.
    candidates : tuple of LawCandidate
        Laws and error models, those with the fewest parameters first.
    dropped : dict of str to float
        Laws that were given up after the search, with the fraction of the variance that they leave unexplained.
    chosen : LawCandidate
        The chosen law and error model.
    result : SamplingResult
        Draws of the posterior of the chosen law.
    rival_results : dict of str to SamplingResult
        Draws of the posterior of other laws whose evidence is close, by their names: draws decide between these laws.
    on_parts : tuple of LawOnParts
        The laws, with every error model, fitted to parts of a cyclic test; predictions are averaged over them.
    missing : MissingTerms or None
        Terms of the force that the best law without further terms lacks in a cyclic test. If this law predicts later half-cycles
        better with the terms, it is one of the candidates.
    """

    result: SamplingResult = field(repr=False)
    rival_results: dict[str, SamplingResult] = field(repr=False, default_factory=dict)
    on_parts: tuple[LawOnParts, ...] = field(repr=False, default=())
    missing: MissingTerms | None = field(repr=False, default=None)

    @property
    def sentence(self) -> str:
        """The choice in sentences, with what the law lacks."""
        lacking = f" {self.lacking}" if self.missing is not None and self.missing.names else ""
        return f"{super().sentence}{self._beside_rivals}{lacking}"

    @property
    def _beside_rivals(self) -> str:
        """What draws say of the laws whose evidence is close, in sentences."""
        text, own = "", self.result.log_evidence
        for word, result in self.rival_results.items():
            other, converged = result.log_evidence, self.result.verdict().converged and result.verdict().converged
            # Draws that have not converged did not take part in the choice.
            if own is not None and other is not None and converged:
                title, behind = self.of_law(word)[0].law.title, own.value - other.value
                error = np.hypot(own.error, other.error)
                text += f" By draws, the log evidence of the {title} is {behind:.1f} ± {error:.1f} nats smaller."
        return text

    @property
    def lacking(self) -> str:
        """What the law lacks, and whether it predicts better with these terms, in sentences; empty if no terms were sought."""
        if self.missing is None:
            return ""
        if not self.missing.holds:
            return self.missing.sentence
        if self.of_law(self.missing.extended.word):
            return f"{self.missing.sentence} The law with these terms is one of the compared laws."
        return f"{self.missing.sentence} But fitted anew with these terms to the first part, the law predicts the rest no better."

    def _evidence_for(self, name: str) -> float:
        """Log evidence for a parameter by draws where they reach its neutral value; see `LawComparison.mechanisms`."""
        names, fit = self.result.names, self.chosen.fit
        if self.result.verdict().converged and name in fit.model.free:
            prior, neutral = fit.posterior.space.marginals[name], fit.law.parameters()[name].neutral
            assert neutral is not None
            by_draws = log_evidence_by_draws(prior, self.result.flat[:, names.index(name)], neutral)
            if by_draws is not None:
                return by_draws
        return super()._evidence_for(name)

    @cached_property
    def weights(self) -> dict[str, float]:
        """Weights of the laws in a prediction, by how well they predict later half-cycles of the test from earlier ones."""
        return self._by_law(self._weights_to_all)

    @cached_property
    def _weights_to_all(self) -> Float[np.ndarray, " member"]:
        return weights_by_prediction(self.on_parts, TO_ALL)

    @property
    def averaging(self) -> str:
        """How a prediction averages the laws, in sentences."""
        shares = sorted(
            ((weight, word) for word, weight in self.weights.items() if weight > SHOWN_WEIGHT), reverse=True
        )
        named = listed([f"the {self.of_law(word)[0].law.title} {weight:.0%}" for weight, word in shares])
        text = f"Predictions average the laws by how well they predict later half-cycles from earlier ones: {named}."
        if self.weights[self.chosen.law.word] < 0.5:
            title = self.chosen.law.title
            text += (
                f" The {title} has the larger evidence for the whole test, but its fits to earlier parts predict worse."
            )
        return text

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

    @cached_property
    def held_out(self) -> CyclicPrediction:
        """The force of the whole test, predicted from its first half-cycles by the average of the laws."""
        return self._averaged(TO_FIRST_PART, self.cyclic_test)

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
        return self._averaged(TO_ALL, self.cyclic_test.along(displacement))

    @property
    def cyclic_test(self) -> CyclicTest:
        """The test, if it is a cyclic test; otherwise an `InputError`."""
        if isinstance(self.test, CyclicTest):
            return self.test
        raise InputError(
            "LawChoice",
            "a test under a motion",
            "a cyclic test",
            "Simulate choice.chosen.fit.model with the draws of choice.result.",
        )

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
    def unidentified(self) -> tuple[str, ...]:
        """Parameters of the chosen law whose posterior is nearly as wide as their prior."""
        names, space = self.chosen.fit.model.free, self.test.priors(self.chosen.law)
        # In coordinates in which every prior is a standard normal distribution
        scores = scipy.special.ndtri(space.cdf(self.result.flat[:, : len(names)]).clip(SMALLEST, 1.0 - SMALLEST))
        return tuple(name for name, sd in zip(names, scores.std(axis=0), strict=True) if sd > LITTLE)

    @cached_property
    def not_reached(self) -> tuple[str, ...]:
        """Forces and displacements among the law's parameters, 95 % of whose draws lie above the largest of the test."""
        largest = {"N": self.test.largest_force, "m": self.test.largest_displacement}
        described, names = self.chosen.law.parameters(), self.chosen.fit.model.free
        return tuple(
            name
            for name, draws in zip(names, self.result.flat[:, : len(names)].T, strict=True)
            if name in described
            and described[name].unit in largest
            and np.quantile(draws, 0.05) > largest[described[name].unit]
        )


@check_arguments
def choose_model(
    test: CyclicTest | MotionTest,
    laws: Sequence[str | HystereticLaw] | None = None,
    error_models: Sequence[ErrorModel] = ERROR_MODELS["auto"],
    *,
    seed: int = 0,
    folder: str | os.PathLike[str] | None = None,
    progress: Progress | None = None,
) -> LawChoice:
    """Choose the hysteretic law of a specimen from a cyclic test, or from its responses to motions.

    Every law is fitted from many starts with its default priors for the test, to the whole test and to its first part: 70 % of
    the half-cycles, or 70 % of the sum of squares of the responses. Among the laws that leave only noise of the sensors, the
    evidence decides; if there is none, among those that predict the rest nearly as well as the best. The posterior of the chosen
    law is sampled.

    Parameters
    ----------
    test : CyclicTest or MotionTest
        The test.
    laws : sequence of str or HystereticLaw, optional
        The laws to choose among; by default all, without the linear spring for a cyclic test.
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
    if laws is None:
        laws = tuple(LAWS) if isinstance(test, MotionTest) else INELASTIC
    candidates_of = [law_of("choose_model(laws)", law) for law in laws]
    if not candidates_of:
        raise InputError("choose_model(laws)", "no law", f"one or more of {', '.join(LAWS)}")
    for errors in error_models:
        given = errors.describe()
        if given["kind"] != "iid" and not (given["kind"] == "ar1" and given.get("white") == 0.0):
            raise InputError("choose_model(error_models)", f"{type(errors).__name__}", "IID() and AR1(white=0.0)")
    store = FitStore.of_choice(test, candidates_of, error_models, seed, folder)
    draws = None if folder is None else Path(folder) / DRAWS_OF_LAW
    return choose_among(test, candidates_of, error_models, seed, store, draws, progress)


def choose_among(
    test: CyclicTest | MotionTest,
    laws: Sequence[HystereticLaw],
    error_models: Sequence[ErrorModel],
    seed: int,
    store: FitStore,
    draws: Path | None = None,
    progress: Progress | None = None,
) -> LawChoice:
    """Choose among laws whose fits are kept in a store; the draws of the chosen law go to a file if there is one."""
    compared = compare_laws(test, laws, error_models, seed, store, progress)
    missing, on_parts = None, []
    if isinstance(test, CyclicTest):
        missing = find_missing_terms(test, compared.chosen)
        if missing.holds:
            extended = candidates_with_terms(compared.chosen, missing, error_models, store)
            if _smallest_error(extended) < _smallest_error(compared.of_law(compared.chosen.law.word)):
                compared = compared.with_candidates(extended)
        log.info("Fitting the laws to parts of the test, to see how well they predict the rest.")
        for word in dict.fromkeys(candidate.law.word for candidate in compared.candidates):
            on_parts += _on_parts(test, compared.of_law(word), error_models, seed, store)
    log.info("Sampling the posterior of the %s.", listed([c.law.title for c in (compared.chosen, *compared.rivals)]))
    results = {c: c.fit.sampled(seed, _draws_of(c, compared, draws)) for c in (compared.chosen, *compared.rivals)}
    on_parts = _with_posterior_draws(on_parts, results, seed, draws)
    chosen = _chosen_by_draws(results)
    of_comparison = {f.name: getattr(compared, f.name) for f in dataclasses.fields(LawComparison)} | {"chosen": chosen}
    rivals = {c.law.word: result for c, result in results.items() if c is not chosen}
    return LawChoice(
        **of_comparison, result=results[chosen], rival_results=rivals, on_parts=tuple(on_parts), missing=missing
    )


def _draws_of(candidate: LawCandidate, compared: LawComparison, draws: Path | None) -> Path | None:
    """Return the file for the draws of a candidate, if there is one for those of the chosen law."""
    return draws if draws is None or candidate is compared.chosen else _file_of_draws(draws, candidate.law.word)


def _file_of_draws(draws: Path, words: str) -> Path:
    """Return the file for other draws beside those of the chosen law."""
    return draws.with_name(f"{draws.stem}_{'_'.join(re.findall('[a-z0-9]+', words))}{draws.suffix}")


def _with_posterior_draws(
    on_parts: Sequence[LawOnParts],
    results: Mapping[LawCandidate, SamplingResult],
    seed: int,
    draws: Path | None,
) -> list[LawOnParts]:
    """Return laws on parts with the draws of the sampled posteriors.

    Where the evidence shows that the normal approximation of a law misses its posterior, the posterior of the first part is
    sampled, too: its spread is that of the prediction of the rest.
    """
    missed = {
        c.law.word
        for c, result in results.items()
        if result.log_evidence is not None and abs(result.log_evidence.value - c.fit.log_evidence) > MISSED
    }
    weights = weights_by_prediction(on_parts, TO_FIRST_PART) if missed else np.zeros(len(on_parts))
    converged = {c.fit: result for c, result in results.items() if result.verdict().converged}
    found = []
    for law, weight in zip(on_parts, weights, strict=True):
        of_whole, of_first, sampled = law.fits[TO_ALL], law.fits[TO_FIRST_PART], {}
        if of_whole in converged:
            sampled[TO_ALL] = converged[of_whole].flat[:, : len(of_whole.fitted)]
        if law.word in missed and weight > LITTLE_WEIGHT:
            log.info("Sampling the posterior of the %s for the first part.", of_first.law.title)
            store = (
                None
                if draws is None
                else _file_of_draws(draws, f"first {law.word} {of_first.errors.describe()['kind']}")
            )
            sampled[TO_FIRST_PART] = of_first.sampled(seed, store, RUNS_FOR_FIRST).flat[:, : len(of_first.fitted)]
        found.append(dataclasses.replace(law, sampled=sampled) if sampled else law)
    return found


def _chosen_by_draws(results: Mapping[LawCandidate, SamplingResult]) -> LawCandidate:
    """Return the candidate of largest evidence by converged draws, or the first, which Laplace's approximation prefers."""
    first = next(iter(results))
    evidence = {c: r.log_evidence.value for c, r in results.items() if r.log_evidence and r.verdict().converged}
    return max(evidence, key=lambda c: evidence[c]) if first in evidence else first


def _smallest_error(candidates: Sequence[LawCandidate]) -> float:
    """Return the smallest prediction error; infinite if there is no candidate."""
    return min((candidate.prediction_error for candidate in candidates), default=np.inf)


def _on_parts(
    test: CyclicTest,
    candidates: list[LawCandidate],
    error_models: Sequence[ErrorModel],
    seed: int,
    store: FitStore,
) -> list[LawOnParts]:
    """Return one law with every error model, fitted to shorter and longer parts of a test; empty if a fit fails."""
    law, first = candidates[0].law, test.first
    of_first = [candidate.of_first for candidate in candidates if candidate.of_first is not None]
    if first is None or not of_first:
        return []
    # A law with further terms was not searched: its terms come from a fit.
    searched = minima_of_first(first, law, seed, store) if law.word in LAWS else []
    starts = [of_first[0].minimum, *searched[1:]]
    ends = sorted({test.until(share) for share in ORIGINS} - {len(first.force)})
    shorter = [test.part(slice(0, end)) for end in ends if end >= FEWEST]
    earlier = [
        store.fits(law, part, error_models, partial(refine_law, part, law, starts, error_models)) for part in shorter
    ]
    if not all(earlier):
        return []
    fits = [candidate.fit for candidate in candidates]
    return [LawOnParts(test, of_model) for of_model in zip(*earlier, of_first, fits, strict=True)]
