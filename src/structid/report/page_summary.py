"""The summary of a calibration's page: the parameters, whether to believe them, and what to do next."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from structid.core.notebook import ShownAsText
from structid.figures.style import pretty
from structid.inference.model_comparison.comparison import aligned
from structid.report.material.comparison_material import ComparedClass, ComparisonMaterial
from structid.report.material.learnt_parameters import LITTLE, LearntParameter, learnt_parameters
from structid.report.material.material import PosteriorMaterial
from structid.report.tables import percent
from structid.surrogates.base import Surrogate

Trust = Literal["good", "doubtful", "bad"]
"""Reliability of a statement."""

ORDER: tuple[Trust, ...] = ("good", "doubtful", "bad")

MARKS: dict[Trust, str] = {"good": "✓", "doubtful": "!", "bad": "✗"}

TIED = 0.9
"""Correlation above which two parameters are determined jointly better than separately."""


@dataclass(frozen=True)
class Believed:
    """Answer to one part of the question whether to believe the numbers."""

    about: str  # subject
    trust: Trust  # ``"good"``, ``"doubtful"`` or ``"bad"``
    said: str  # the answer, in few words


@dataclass(frozen=True)
class PageSummary(ShownAsText):
    """The summary."""

    parameters: list[LearntParameter]  # parameters of the model
    believed: list[Believed]  # answers on the sampling, the surrogate, the model
    unsaid: list[str]  # what the data do not determine, one sentence each
    further: list[str]  # what to do next, one sentence each, most important first

    @property
    def elsewhere(self) -> bool:
        """Whether intervals for another record differ."""
        return any(p.elsewhere is not None for p in self.parameters)

    @property
    def truths(self) -> tuple[int, int] | None:
        """Number of true values inside the intervals to be used, and their total; None where none is known."""
        held = [p.holds_truth for p in self.parameters if p.holds_truth is not None]
        return (sum(held), len(held)) if held else None

    def __str__(self) -> str:
        heads = [
            "",
            "mean",
            "90 % interval",
            *(["for another record"] if self.elsewhere else []),
            *(["truth"] if self.truths else []),
        ]
        rows = [
            [
                p.label,
                p.value,
                p.in_words(p.interval),
                *([p.in_words(p.honest)] if self.elsewhere else []),
                *([p.true_value] if self.truths else []),
            ]
            for p in self.parameters
        ]
        answers = [[f"{MARKS[b.trust]} {b.about}", b.said] for b in self.believed]
        return "\n".join([*aligned(heads, rows), *aligned(["", ""], answers)[1:]])

    @property
    def wrong(self) -> bool:
        """Whether the model contradicts the data."""
        return any(b.about == "Model" and b.trust == "bad" for b in self.believed)

    @property
    def trust(self) -> Trust:
        """The worst of the answers."""
        return max((b.trust for b in self.believed), key=ORDER.index)


def page_summary(material: PosteriorMaterial) -> PageSummary:
    """Build the summary."""
    parameters = learnt_parameters(material)
    return PageSummary(parameters, _answers(material), _unsaid(material, parameters), _further(material, parameters))


def comparison_summary(material: ComparisonMaterial) -> tuple[list[Believed], list[str]]:
    """Build the summary of a comparison."""
    believed = [_of_a_class(one) for one in material.classes]
    unfinished = [one.name for one in material.classes if not one.figures.trusted]
    best = material.best
    if unfinished:
        return believed, [
            f"Finish {_listed(unfinished)} first: structid run … --resume. Until then the order may change."
        ]
    verdict = best.material.result.verdict()
    if verdict.wrong_model:
        return believed, [
            f"{best.name} is the best of these, and still wrong for the data. Look in its report at what it leaves, and give it "
            "what it lacks: another class, calibrated to the same measurement, joins this comparison."
        ]
    return believed, [
        f"Use {best.name}: its parameters, intervals and predictions are below, and in its own report.",
        "Another class that you hold for possible is calibrated to the same measurement, and joins this comparison.",
    ]


def _of_a_class(one: ComparedClass) -> Believed:
    """Whether the numbers of a class, and the class itself, may be believed."""
    answers = _answers(one.material)
    worst = max(answers, key=lambda answer: ORDER.index(answer.trust))
    warning = "" if one.figures.trusted else "its numbers are not to be trusted; "
    return Believed(one.name, worst.trust, warning + answers[-1].said)


def _answers(material: PosteriorMaterial) -> list[Believed]:
    """Answers on the sampling, the surrogate, the model."""
    return [_sampling(material), *_surrogate(material), *_model(material)]


def _sampling(material: PosteriorMaterial) -> Believed:
    verdict = material.result.verdict()
    if not verdict.converged:
        return Believed("Sampling", "bad", "not converged: do not use these numbers")
    return Believed("Sampling", "good", "converged; independent ensembles agree")


def _surrogate(material: PosteriorMaterial) -> list[Believed]:
    """Answer on the surrogate: its certificate or validation; none where the model itself was sampled."""
    if material.result.cost is not None:
        return [Believed("Surrogate", "good", "only proposed; the model itself decided on every step")]
    if material.calibration is None:
        validated = Surrogate in material.results
        return [Believed("Surrogate", "doubtful", "validated, and not certified")] if validated else []
    certificate = material.calibration.certificate
    if certificate.certified:
        runs = f"{certificate.true_runs} runs of the model"
        bound = f"no mean is off by more than {certificate.mean_bound.max():.2g} standard deviations"
        return [Believed("Surrogate", "good", f"certified by {runs}: {bound}")]
    if certificate.usable:
        return [Believed("Surrogate", "doubtful", "usable with re-weighting: the numbers here are corrected")]
    return [Believed("Surrogate", "bad", "not certified: do not use these numbers")]


def _model(material: PosteriorMaterial) -> list[Believed]:
    verdict = material.result.verdict()
    if not verdict.converged:
        return []
    left = f"its best prediction leaves {percent(verdict.unexplained)} of the measured variance unexplained"
    if verdict.wrong_model:
        return [Believed("Model", "bad", f"wrong for these data; {left}")]
    if verdict.wrong_error_model:
        return [Believed("Model", "doubtful", f"the errors are not what their error model assumes; {left}")]
    return [Believed("Model", "good", f"nothing speaks against it; {left}")]


def _unsaid(material: PosteriorMaterial, parameters: list[LearntParameter]) -> list[str]:
    """What the data do not determine, given the model."""
    if not material.result.verdict().converged:
        return []
    sentences = []
    little = [pretty(p.name) for p in _hardly_known(parameters)]
    if little:
        sentences.append(
            f"The data say little of {_listed(little)}: what is known of {'it' if len(little) == 1 else 'them'} is in the prior."
        )
    adrift = [pretty(p.name) for p in parameters if p.unknown_elsewhere and pretty(p.name) not in little]
    if adrift:
        sentences.append(
            f"On another record the data say little of {_listed(adrift)}: while the structure moves, "
            f"{'it drifts' if len(adrift) == 1 else 'they drift'} by about as much as the prior spreads."
        )
    draws, weights = material.weighted_draws
    count = len(parameters)
    covariance = np.atleast_2d(np.cov(draws[:, :count].T, aweights=weights))
    sds = np.sqrt(np.diag(covariance))
    correlation = covariance / np.outer(sds, sds)
    tied = [(i, j) for i, j in zip(*np.triu_indices(count, 1), strict=True) if abs(correlation[i, j]) > TIED]
    if tied:
        pairs = [f"{pretty(parameters[i].name)} and {pretty(parameters[j].name)}" for i, j in tied]
        sizes = ", ".join(f"{correlation[i, j]:.2f}" for i, j in tied)
        which = "this pair is" if len(tied) == 1 else "these pairs are"
        sentences.append(
            f"{'; '.join(pairs)}: {which} known together better than each parameter by itself (correlation {sizes})."
        )
    return sentences or ["Every parameter is known better than before, each by itself."]


def _further(material: PosteriorMaterial, parameters: list[LearntParameter]) -> list[str]:
    """What to do next. Anything that invalidates the numbers comes first, and alone."""
    verdict, calibration = material.result.verdict(), material.calibration
    exact = material.result.cost is not None
    if not verdict.converged:
        return ["Go on sampling: raise steps or particles in the study, and run it again with --resume."]
    if calibration is not None and not (calibration.certificate.usable or exact):
        enough = calibration.enough_to_go_on
        return [f"Allow more runs of the model: true_runs = {enough} or more, and run it again with --resume."]
    # A prior that the data contradict comes before everything else that may be wrong.
    sentences = [
        f"{warned.said[:1].upper()}{warned.said[1:]}. {warned.cure}" for warned in verdict.against_priors if warned.cure
    ]
    if verdict.another_size:
        sentences.append(
            "Look at the units of the measurement, of the record and of the priors: the best prediction is of another size than "
            "what was measured. Mend them, and run again in another folder."
        )
    elif verdict.wrong_model:
        sentences.append(
            "Do not take these parameters for those of the structure. Give the model what it lacks (a sharper or softer "
            "yield, degradation, pinching, an offset of the instrument), calibrate that to the same measurement, and see which one "
            "the data favour: structid compare FIRST SECOND --out comparison."
        )
        if any(p.elsewhere is not None for p in parameters):
            sentences.append("Until then use the intervals for another record; they allow for what the model lacks.")
    elif verdict.wrong_error_model:
        sentences.append("Let the data choose the error model: leave [discrepancy] out of the study.")
    if _hardly_known(parameters):
        sentences.append(
            "To learn more of what the data say little of, measure another channel or a stronger motion, or take its prior "
            "from tests."
        )
    if not sentences:
        with_it = "[[prediction.records]] in a study or predict(record) in Python"
        sentences.append(
            f"Use it: what other records do to the structure is below; further ones come with {with_it}."
            if material.other_records
            else f"Use it: predict what other records do to the structure, with {with_it}."
        )
        sentences.append(
            "If there is another measurement, add it as a further observation, or see whether it is predicted."
        )
    return sentences


def _hardly_known(parameters: list[LearntParameter]) -> list[LearntParameter]:
    """Parameters with a posterior close to the prior; a shifted one is not among them."""
    return [p for p in parameters if p.narrowed < LITTLE and p.prior[0] <= p.mean <= p.prior[1]]


def _listed(names: list[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
