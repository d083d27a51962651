"""Which law of the errors the data favour: by its evidence, each law with the same model and measurements."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from structid.errors import ConvergenceError, InputError
from structid.inference.likelihood.discrepancy import ErrorLaw
from structid.inference.likelihood.drifting import Drifting
from structid.inference.likelihood.independent import IID
from structid.inference.likelihood.kernels import AR1, DampedCosine
from structid.inference.likelihood.observation import Observation
from structid.inference.likelihood.posterior import Posterior
from structid.inference.sample import sample
from structid.inference.sampling.sampler import Evidence
from structid.inference.sampling.tempered import SMC
from structid.inference.sampling_result import SamplingResult
from structid.models.drifting_model import drift_name
from structid.models.face import Map, Model, Progress
from structid.probability.space import ParameterSpace
from structid.streams import Purpose, derived_seed

EXPLORER = SMC(particles=300, ensembles=2, steps=30, effective_share=0.5, correlation=0.4)
"""Particles under each law."""

ERRORS_APART = 2.0
"""A law is preferred to a simpler one where its log evidence is larger by more than so many of their combined errors."""


def usual_laws(model: Model) -> tuple[ErrorLaw, ...]:
    """List the laws that are worth a try, the simplest first.

    Parameters
    ----------
    model : Model
        The model.

    Returns
    -------
    tuple of ErrorLaw
        Independent, AR(1) and narrow-band errors; and, where the model allows it, drifting parameters beside independent and
        beside narrow-band errors.
    """
    inside = (Drifting(), Drifting(errors=DampedCosine())) if model.can_drift else ()
    return (IID(), AR1(), DampedCosine(), *inside)


@dataclass(frozen=True, eq=False)
class LawChoice:
    """Laws of the errors, and what the data say of each.

    Parameters
    ----------
    results : tuple of SamplingResult
        Draws under each law, the simplest law first.
    """

    results: tuple[SamplingResult, ...] = field(repr=False)

    @property
    def laws(self) -> tuple[str, ...]:
        """The laws in words."""
        return tuple(_in_words(_posterior(r).law) for r in self.results)

    @property
    def evidences(self) -> tuple[Evidence, ...]:
        """Log evidence of each [nat]."""
        return tuple(_evidence(r) for r in self.results)

    @property
    def chosen(self) -> int:
        """Place of the first law whose evidence is the largest, within the errors of both."""
        best = max(self.evidences, key=lambda e: np.nan_to_num(e.value, nan=-np.inf))
        return next(
            place
            for place, e in enumerate(self.evidences)
            if best.value - e.value <= ERRORS_APART * float(np.hypot(best.error, e.error)) or e is best
        )

    @property
    def result(self) -> SamplingResult:
        """Draws under the chosen law: explored, not yet sampled at length."""
        return self.results[self.chosen]

    @property
    def posterior(self) -> Posterior:
        """The posterior with the chosen law."""
        return _posterior(self.result)

    @property
    def sentence(self) -> str:
        """What was chosen, and what it says of the model."""
        said = f"The data choose {self.laws[self.chosen]}{self._margin}."
        drifts = drift_words(self.result)
        return f"{said} {drifts}" if drifts else said

    @property
    def _margin(self) -> str:
        """How far ahead of the others the chosen law is, in words."""
        others = {place: e.value for place, e in enumerate(self.evidences) if place != self.chosen}
        if not others:
            return ""
        next_best = max(others, key=lambda place: others[place])
        ahead = self.evidences[self.chosen].value - others[next_best]
        if ahead >= 0.0:
            return f", {ahead:.3g} nats ahead of {self.laws[next_best]}"
        return f", which is simpler than {self.laws[next_best]} and within the errors of its evidence"

    def __str__(self) -> str:
        width = max(len(law) for law in self.laws)
        lines = [self.sentence, "".ljust(width) + "   log evidence"]
        for place, (law, evidence) in enumerate(zip(self.laws, self.evidences, strict=True)):
            mark = "  <" if place == self.chosen else ""
            lines.append(f"{law.ljust(width)}{evidence.value:12.1f} ± {evidence.error:.1f}{mark}")
        return "\n".join(lines)


def drift_words(result: SamplingResult) -> str:
    """Say how far the parameters of a model drift.

    Parameters
    ----------
    result : SamplingResult
        Draws of a posterior.

    Returns
    -------
    str
        A sentence; empty where none drifts.
    """
    posterior = result.target
    if not isinstance(posterior, Posterior):
        return ""
    mean, factors = (
        dict(zip(result.names, result.mean, strict=True)),
        dict(zip(result.names, posterior.factors, strict=True)),
    )
    parts = []
    for name in posterior.model_space.names:
        if drift_name(name) in mean:
            drift, unit = mean[drift_name(name)] / factors[name], posterior.units[name]
            share = f" ({drift * factors[name] / abs(mean[name]):.1%} of its mean)" if mean[name] else ""
            parts.append(f"{name} by {drift:.2g}{' ' + unit if unit else ''}{share}")
    return f"The parameters drift while the structure moves: {', '.join(parts)}." if parts else ""


def choose_law(
    space: ParameterSpace,
    model: Model,
    observations: Observation | Sequence[Observation],
    laws: Sequence[ErrorLaw] | None = None,
    *,
    sampler: SMC = EXPLORER,
    seed: int = 0,
    map: Map | None = None,
    progress: Progress | None = None,
) -> LawChoice:
    """Choose the law of the errors by its evidence.

    Parameters
    ----------
    space : ParameterSpace
        The model's unknown parameters and their priors.
    model : Model
        The model, or a surrogate of it: the posterior under each law is sampled, with tens of thousands of runs.
    observations : Observation or sequence of Observation
        What was measured.
    laws : sequence of ErrorLaw, optional
        The laws to choose among, the simplest first; `usual_laws` when left out.
    sampler : SMC
        Particles under each law.
    seed : int
        Seed.
    map : callable, optional
        Maps the runs of an external model, like ``Executor.map``.
    progress : callable, optional
        Called with the percentage done and 100.

    Returns
    -------
    LawChoice
        ``print`` it; ``.posterior`` has the chosen law.

    Raises
    ------
    InputError
        If there is nothing to choose among.
    ConvergenceError
        If no law has an evidence.
    """
    laws = usual_laws(model) if laws is None else tuple(laws)
    if not laws:
        raise InputError("choose_law(laws)", "none", "one law or more")
    results = []
    for place, law in enumerate(laws):
        of = Posterior(space, model, observations, law, map=map)

        def told(done: int, total: int, place: int = place) -> None:
            if progress is not None:
                progress(int(100 * (place + done / total) / len(laws)), 100)

        results.append(sample(of, sampler, derived_seed(seed, Purpose.LAW_CHOICE, place), progress=told))
    if not any(np.isfinite(_evidence(r).value) for r in results):
        raise ConvergenceError("No law has an evidence: every simulation at draws of the prior fails.")
    return LawChoice(tuple(results))


def _posterior(result: SamplingResult) -> Posterior:
    assert isinstance(result.target, Posterior)
    return result.target


def _evidence(result: SamplingResult) -> Evidence:
    assert result.log_evidence is not None, "SMC gives it"
    return result.log_evidence


def _in_words(law: ErrorLaw) -> str:
    """Name of a law, and of the errors that are added where there are others inside the model."""
    word = str(law.describe()["kind"]).replace("_", " ")
    return f"{word} parameters + {_in_words(law.added)}" if law.inside else word
