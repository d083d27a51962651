"""Choice of the error model by its evidence, with the same model and measurements."""

from __future__ import annotations

import logging
import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from structid.core.errors import ConvergenceError, InputError
from structid.core.notebook import ShownAsText
from structid.core.progress import Progress
from structid.core.renamed import renamed_argument, renamed_attribute
from structid.core.streams import Purpose, derived_seed
from structid.core.validation import check_arguments
from structid.inference.error_models.base import ErrorModel
from structid.inference.error_models.drifting import Drifting
from structid.inference.error_models.independent import IID
from structid.inference.error_models.kernels import AR1, DampedCosine
from structid.inference.likelihood.posterior import Posterior
from structid.inference.prediction.parameter_drift import ParameterDrift
from structid.inference.sample import sample
from structid.inference.sampling.base import Evidence
from structid.inference.sampling.smc.smc import SMC
from structid.inference.sampling_result import SamplingResult
from structid.models.base import Map, Model
from structid.observation import Observation
from structid.probability.space import ParameterSpace

AUTO = "auto"
"""Value in place of an error model: the evidence selects the error model."""

CHOICE_SAMPLER = SMC(particles=300, ensembles=2, steps=30, effective_share=0.5, correlation=0.4, scouts=0)
"""Sampler of the posterior under each error model."""

ERRORS_APART = 2.0
"""An error model is preferred to a simpler one if its log evidence is larger by more than this many combined standard errors."""

_log = logging.getLogger(__name__)


def usual_error_models(model: Model) -> tuple[ErrorModel, ...]:
    """List the error models to try, the simplest first."""
    inside = (Drifting(), Drifting(errors=DampedCosine())) if model.can_drift else ()
    return (IID(), AR1(), DampedCosine(), *inside)


@dataclass(frozen=True, eq=False)
class ErrorModelChoice(ShownAsText):
    """Error models compared by their evidence.

    Parameters
    ----------
    results : tuple of SamplingResult
        Draws under each error model, the simplest first.
    added_only : bool
        Whether errors inside the model are excluded, because their hidden values could not be sampled reliably.
    remark : str
        A further sentence on the choice.
    """

    results: tuple[SamplingResult, ...] = field(repr=False)
    added_only: bool = False
    remark: str = ""

    @property
    def error_models(self) -> tuple[str, ...]:
        """Names of the error models."""
        return tuple(_in_words(_posterior(r).error_model) for r in self.results)

    laws = renamed_attribute("laws", "error_models")

    @property
    def evidences(self) -> tuple[Evidence, ...]:
        """Log evidence of each error model [nat]."""
        return tuple(_evidence(r) for r in self.results)

    @property
    def chosen(self) -> int:
        """Index of the simplest error model whose log evidence equals the largest within the standard errors."""
        allowed = {
            index: e
            for index, e in enumerate(self.evidences)
            if not (self.added_only and _posterior(self.results[index]).error_model.inside)
        }
        best = max(allowed.values(), key=lambda e: np.nan_to_num(e.value, nan=-np.inf))
        return next(
            index for index, e in allowed.items() if (best - e).value <= ERRORS_APART * (best - e).error or e is best
        )

    @property
    def result(self) -> SamplingResult:
        """Draws under the chosen error model, from a short run."""
        return self.results[self.chosen]

    @property
    def posterior(self) -> Posterior:
        """The posterior with the chosen error model."""
        return _posterior(self.result)

    @property
    def sentence(self) -> str:
        """Sentences on the choice and its consequences for the model."""
        if self.added_only:
            return (
                f"{self.error_models[self.chosen].capitalize()} errors are used. The evidence favours drifting parameters, "
                "but their hidden values could not be sampled reliably: independent populations disagree."
            )
        choice = self.said
        if not self.posterior.error_model.inside:
            return choice
        drift = ParameterDrift.sampled(self.posterior, self.result.flat).sentence(self.result.mean)
        return " ".join(filter(None, (choice, drift, self.remark)))

    @property
    def said(self) -> str:
        """Sentence on the choice and its margin."""
        return f"The data choose {self.error_models[self.chosen]}{self._margin}."

    @property
    def _margin(self) -> str:
        """Margin of the chosen error model over the others, in words."""
        others = {index: e.value for index, e in enumerate(self.evidences) if index != self.chosen}
        if not others:
            return ""
        next_best = max(others, key=lambda index: others[index])
        ahead = self.evidences[self.chosen] - self.evidences[next_best]
        if ahead.value >= 0.0:
            nats = f"{ahead.value:.3g}" if ahead.value < 1000.0 else f"{ahead.value:,.0f}"
            return f", {nats} ± {ahead.error:.1f} nats ahead of {self.error_models[next_best]}"
        return (
            f", which is simpler than {self.error_models[next_best]} and has the same evidence within the "
            "standard errors"
        )

    def __str__(self) -> str:
        width = max(len(error_model) for error_model in self.error_models)
        lines = [self.sentence, "".ljust(width) + "   log evidence"]
        for index, (error_model, evidence) in enumerate(zip(self.error_models, self.evidences, strict=True)):
            mark = "  <" if index == self.chosen else ""
            lines.append(f"{error_model.ljust(width)}{evidence.value:12.1f} ± {evidence.error:.1f}{mark}")
        return "\n".join(lines)


@renamed_argument(laws="error_models")
@check_arguments
def choose_error_model(
    space: ParameterSpace,
    model: Model,
    observations: Observation | Sequence[Observation],
    error_models: Sequence[ErrorModel] | None = None,
    *,
    sampler: SMC = CHOICE_SAMPLER,
    seed: int = 0,
    map: Map | None = None,
    progress: Progress | None = None,
    store: str | os.PathLike[str] | None = None,
) -> ErrorModelChoice:
    """Choose the error model by its evidence.

    Parameters
    ----------
    space : ParameterSpace
        The model's unknown parameters and their priors.
    model : Model
        The model, or a surrogate of it: the posterior under each error model is sampled, with tens of thousands of runs.
    observations : Observation or sequence of Observation
        The measurements.
    error_models : sequence of ErrorModel, optional
        The error models to choose among, the simplest first; by default `usual_error_models`.
    sampler : SMC
        Sampler of the posterior under each error model.
    seed : int
        Seed.
    map : callable, optional
        Maps the runs of an external model, like ``Executor.map``.
    progress : callable, optional
        Called with the percentage done and 100.
    store : path-like, optional
        Folder for the draws under each error model; an interrupted choice continues from it.

    Returns
    -------
    ErrorModelChoice
        ``print`` shows the comparison; ``.posterior`` has the chosen error model.

    Raises
    ------
    InputError
        If no error model is given.
    ConvergenceError
        If no error model has a finite log evidence.

    Examples
    --------
    >>> import structid as si
    >>> choice = si.choose_error_model(space, model, measured)  # doctest: +SKIP
    >>> print(choice)  # doctest: +SKIP
    """
    return choose_among(Posterior(space, model, observations, map=map), error_models, sampler, seed, progress, store)


def choose_among(
    posterior: Posterior,
    error_models: Sequence[ErrorModel] | None = None,
    sampler: SMC = CHOICE_SAMPLER,
    seed: int = 0,
    progress: Progress | None = None,
    store: str | os.PathLike[str] | None = None,
) -> ErrorModelChoice:
    """Choose the error model of a posterior; see `choose_error_model`."""
    if error_models is not None and not error_models:
        raise InputError("choose_error_model(error_models)", "no error model", "one or more")
    under = [
        posterior.on(error_model=error_model)
        for error_model in (usual_error_models(posterior.model) if error_models is None else error_models)
    ]
    if error_models is None:  # without compiled vector code, a drifting model takes minutes
        under = [each for each in under if each.in_lanes or not each.error_model.inside]
    results, folder = [], None if store is None else Path(store)
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
    for index, of in enumerate(under):
        kept = None if folder is None else folder / f"law_{index + 1}.h5"

        def report(done: int, total: int, index: int = index) -> None:
            if progress is not None:
                progress(int(100 * (index + done / total) / len(under)), 100)

        results.append(sample(of, sampler, derived_seed(seed, Purpose.LAW_CHOICE, index), kept, progress=report))
    if not any(np.isfinite(_evidence(r).value) for r in results):
        raise ConvergenceError(
            "No error model has a finite log evidence: all simulations of prior draws fail. Check the priors."
        )
    choice = ErrorModelChoice(tuple(results))
    _log.info("%s", choice.said)
    return choice


def _posterior(result: SamplingResult) -> Posterior:
    assert isinstance(result.target, Posterior)
    return result.target


def _evidence(result: SamplingResult) -> Evidence:
    assert result.log_evidence is not None, "SMC estimates the evidence"
    return result.log_evidence


def _in_words(error_model: ErrorModel) -> str:
    """Name of an error model, including its added errors if it also has errors inside the model."""
    word = str(error_model.describe()["kind"]).replace("_", " ")
    return f"{word} parameters + {_in_words(error_model.added)}" if error_model.inside else word
