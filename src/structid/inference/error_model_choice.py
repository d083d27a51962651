"""Choice of the error model by its evidence, with the same model and measurements."""

from __future__ import annotations

import logging
import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from structid.core.errors import ConvergenceError, InputError
from structid.core.notebook import ShownAsText
from structid.core.progress import Progress
from structid.core.renamed import renamed_argument, renamed_attribute
from structid.core.streams import Purpose, derived_seed
from structid.core.validation import check_arguments
from structid.inference.diagnostics.residuals import WhitenedResidual
from structid.inference.error_models.base import ErrorModel
from structid.inference.error_models.drifting import Drifting
from structid.inference.error_models.independent import IID
from structid.inference.error_models.kernels import AR1, DampedCosine
from structid.inference.error_models.outliers import Contaminated, Student
from structid.inference.error_models.proportional import Proportional
from structid.inference.error_models.quantised import Quantised, grid_step
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

MOST_UNCORRELATED = 4
"""Largest number of error models that `error_models_for` suggests."""

ERRORS_APART = 2.0
"""An error model is preferred to a simpler one if its log evidence is larger by more than this many combined standard errors."""

LARGEST_ERROR = 2.0
"""Standard error of a log evidence [nat] above which error models that cannot be told apart are sampled again, more finely."""

_log = logging.getLogger(__name__)


COARSE = 1.5
"""Step of rounded values, relative to the sd of the residuals, above which rounding deserves its own error model. With a finer
step, the errors before the rounding make those after it independent."""


def usual_error_models(model: Model) -> tuple[ErrorModel, ...]:
    """List the error models that are tried for residuals that are not white, the simplest first."""
    inside = (Drifting(), Drifting(errors=DampedCosine())) if model.can_drift else ()
    return (IID(), AR1(), DampedCosine(), *inside)


def error_models_for(result: SamplingResult) -> tuple[ErrorModel, ...]:
    """List the error models without correlation that the residuals of independent normal errors call for."""
    residuals = result.residuals
    suggested: list[ErrorModel] = []
    if any(residual.may_be_heavy_tailed for residual in residuals):
        suggested += [Student(), Contaminated()]
    if any(residual.may_be_uneven for residual in residuals):
        suggested.append(Proportional())
    if residuals and _coarsely_rounded(_posterior(result).observations, residuals):
        suggested.append(Quantised())
    return tuple(suggested)


def _coarsely_rounded(observations: Sequence[Observation], residuals: Sequence[WhitenedResidual]) -> bool:
    """Whether all values are rounded, and some to a step that is not small beside the residuals."""
    relative = []
    for residual in residuals:
        observation = observations[residual.observation]
        values = observation.values[:, observation.channels.index(residual.channel)]
        step = grid_step(values) if observation.sd is None else None
        if step is None or residual.response is None:
            return False
        relative.append(step / max(float(np.nanstd(values - residual.response)), np.finfo(float).tiny))
    return max(relative) > COARSE


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
    def contenders(self) -> list[int]:
        """Indices of the error models whose log evidence equals the largest within the standard errors, the simplest first."""
        allowed = {
            index: e
            for index, e in enumerate(self.evidences)
            if not (self.added_only and _posterior(self.results[index]).error_model.inside)
        }
        best = max(allowed.values(), key=lambda e: np.nan_to_num(e.value, nan=-np.inf))
        return [
            index for index, e in allowed.items() if (best - e).value <= ERRORS_APART * (best - e).error or e is best
        ]

    @property
    def chosen(self) -> int:
        """Index of the simplest error model whose log evidence equals the largest within the standard errors."""
        return self.contenders[0]

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
        if len(self.results) == 1:
            return f"The data choose {self.error_models[0]}: the residuals give no reason to try another error model."
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
        The error models to choose among, the simplest first. By default the residuals of independent normal errors decide: heavy
        tails call for `Student` and `Contaminated`, errors that grow with the response for `Proportional`, coarsely rounded values
        for `Quantised`. Unless the residuals under the best of these are white, AR(1) and damped cosine errors and drifting
        parameters are tried.
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
    usual = usual_error_models(posterior.model)
    if error_models is None:
        trials = _Trials(posterior, sampler, seed, store, progress, len(usual) + MOST_UNCORRELATED)
        trials.sample_under(usual[:1])
        trials.sample_under(error_models_for(trials.results[0]))
        if not _leaves_white_residuals(trials.best):
            # Without compiled vector code, a drifting model takes minutes.
            trials.sample_under(m for m in usual[1:] if not m.inside or posterior.on(error_model=m).in_lanes)
    else:
        trials = _Trials(posterior, sampler, seed, store, progress, len(error_models))
        trials.sample_under(error_models)
    if not np.isfinite(_evidence(trials.best).value):
        raise ConvergenceError(
            "No error model has a finite log evidence: all simulations of prior draws fail. Check the priors."
        )
    choice = trials.told_apart()
    if progress is not None:
        progress(100, 100)
    _log.info("%s", choice.said)
    return choice


@dataclass(frozen=True, eq=False)
class _Trials:
    """Draws under one error model after another."""

    posterior: Posterior
    sampler: SMC
    seed: int
    store: str | os.PathLike[str] | None
    progress: Progress | None
    most: int  # largest number of error models
    results: list[SamplingResult] = field(default_factory=list)

    @property
    def best(self) -> SamplingResult:
        """Draws under the error model with the largest evidence."""
        return max(self.results, key=lambda r: np.nan_to_num(_evidence(r).value, nan=-np.inf))

    def sample_under(self, error_models: Iterable[ErrorModel]) -> None:
        """Sample the posterior under further error models."""
        for error_model in error_models:
            index = len(self.results)
            self.results.append(self._sampled(self.posterior.on(error_model=error_model), index, self.sampler))

    def told_apart(self) -> ErrorModelChoice:
        """Choose, and sample error models again if only the errors of their evidences keep them from being told apart."""
        choice = ErrorModelChoice(tuple(self.results))
        contenders = choice.contenders
        if len(contenders) == 1 or max(choice.evidences[index].error for index in contenders) <= LARGEST_ERROR:
            return choice
        # Data that determine the parameters to 1e-5 of their prior need many small steps from the prior to the posterior.
        finer = replace(self.sampler, particles=2 * self.sampler.particles, effective_share=0.8, correlation=0.1)
        for index in contenders:
            self.results[index] = self._sampled(_posterior(self.results[index]), index, finer, "_finer")
        return ErrorModelChoice(tuple(self.results))

    def _sampled(self, posterior: Posterior, index: int, sampler: SMC, suffix: str = "") -> SamplingResult:
        kept = None if self.store is None else Path(self.store) / f"law_{index + 1}{suffix}.h5"
        if kept is not None:
            kept.parent.mkdir(parents=True, exist_ok=True)

        def report(done: int, total: int) -> None:
            if self.progress is not None and not suffix:  # what is sampled again has been counted
                self.progress(min(int(100 * (index + done / total) / self.most), 100), 100)

        seed = derived_seed(self.seed, Purpose.LAW_CHOICE, index)
        return sample(posterior, sampler, seed, kept, progress=report)


def _leaves_white_residuals(result: SamplingResult) -> bool:
    """Whether nothing in the residuals calls for an error model that is correlated in time."""
    return bool(result.residuals) and all(residual.is_white for residual in result.residuals)


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
