"""The first screen of a calibration's page: what the parameters are, whether to believe them, and what to do next."""

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

Trust = Literal["good", "doubtful", "bad"]
"""How far a reader may rely on something."""

ORDER: tuple[Trust, ...] = ("good", "doubtful", "bad")

MARKS: dict[Trust, str] = {"good": "✓", "doubtful": "!", "bad": "✗"}

TIED = 0.9
"""Correlation from which on two parameters are known together better than each by itself."""


@dataclass(frozen=True)
class Believed:
    """An answer to one part of the question whether to believe the numbers."""

    about: str  # What it is about
    trust: Trust  # ``"good"``, ``"doubtful"`` or ``"bad"``
    said: str  # The answer, in few words


@dataclass(frozen=True)
class Headline(ShownAsText):
    """The first screen."""

    parameters: list[LearntParameter]  # Of the model
    believed: list[Believed]  # The sampling, the surrogate, the model
    unsaid: list[str]  # What the data do not say, one sentence each
    further: list[str]  # What to do next, one sentence each, the most important first

    @property
    def elsewhere(self) -> bool:
        """Whether intervals for another record are others."""
        return any(p.elsewhere is not None for p in self.parameters)

    @property
    def truths(self) -> tuple[int, int] | None:
        """How many true values lie in the intervals to be used, and how many there are; None where none is known."""
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
        """Whether the model is wrong for the data."""
        return any(b.about == "Model" and b.trust == "bad" for b in self.believed)

    @property
    def trust(self) -> Trust:
        """The worst of the answers."""
        return max((b.trust for b in self.believed), key=ORDER.index)


def headline(material: PosteriorMaterial) -> Headline:
    """Put the first screen together."""
    parameters = learnt_parameters(material)
    return Headline(parameters, _answers(material), _unsaid(material, parameters), _further(material, parameters))


def comparison_headline(material: ComparisonMaterial) -> tuple[list[Believed], list[str]]:
    """Answer whether to believe a comparison, and say what to do next."""
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
    """Whether the numbers of a class may be believed, and whether the class itself may."""
    answers = _answers(one.material)
    worst = max(answers, key=lambda answer: ORDER.index(answer.trust))
    known = "" if one.figures.trusted else "its numbers are not to be trusted; "
    return Believed(one.name, worst.trust, known + answers[-1].said)


def _answers(material: PosteriorMaterial) -> list[Believed]:
    """Of the sampling, of the surrogate, of the model."""
    return [_sampling(material), *_surrogate(material), *_model(material)]


def _sampling(material: PosteriorMaterial) -> Believed:
    verdict = material.result.verdict()
    if not verdict.converged:
        return Believed("Sampling", "bad", "not converged: do not use these numbers")
    return Believed("Sampling", "good", "converged; independent ensembles agree")


def _surrogate(material: PosteriorMaterial) -> list[Believed]:
    """The certificate, or the validation of a surrogate without one; nothing where the model itself was sampled."""
    if material.result.cost is not None:
        return [Believed("Surrogate", "good", "only proposed; the model itself decided on every step")]
    if material.calibration is None:
        return [] if material.surrogate is None else [Believed("Surrogate", "doubtful", "validated, and not certified")]
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
    if verdict.wrong_law:
        return [Believed("Model", "doubtful", f"the errors are not what their law says; {left}")]
    return [Believed("Model", "good", f"nothing speaks against it; {left}")]


def _unsaid(material: PosteriorMaterial, parameters: list[LearntParameter]) -> list[str]:
    """What the data leave open, given the model."""
    if not material.result.verdict().converged:
        return []
    said = []
    little = [pretty(p.name) for p in _hardly_known(parameters)]
    if little:
        said.append(
            f"The data say little of {_listed(little)}: what is known of {'it' if len(little) == 1 else 'them'} is in the prior."
        )
    adrift = [pretty(p.name) for p in parameters if p.unknown_elsewhere and pretty(p.name) not in little]
    if adrift:
        said.append(
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
        said.append(
            f"{'; '.join(pairs)}: {which} known together better than each parameter by itself (correlation {sizes})."
        )
    return said or ["Every parameter is known better than before, each by itself."]


def _further(material: PosteriorMaterial, parameters: list[LearntParameter]) -> list[str]:
    """What to do next. What makes the numbers worthless comes first, and alone."""
    verdict, calibration = material.result.verdict(), material.calibration
    exact = material.result.cost is not None
    if not verdict.converged:
        return ["Go on sampling: raise steps or particles in the study, and run it again with --resume."]
    if calibration is not None and not (calibration.certificate.usable or exact):
        enough = calibration.enough_to_go_on
        return [f"Allow more runs of the model: true_runs = {enough} or more, and run it again with --resume."]
    # A prior that the data contradict comes before everything else that may be wrong.
    said = [
        f"{warned.said[:1].upper()}{warned.said[1:]}. {warned.cure}" for warned in verdict.against_priors if warned.cure
    ]
    if verdict.another_size:
        said.append(
            "Look at the units of the measurement, of the record and of the priors: the best prediction is of another size than "
            "what was measured. Mend them, and run again in another folder."
        )
    elif verdict.wrong_model:
        said.append(
            "Do not take these parameters for those of the structure. Give the model what it lacks (a sharper or softer "
            "yield, degradation, pinching, an offset of the instrument), calibrate that to the same measurement, and see which one "
            "the data favour: structid compare FIRST SECOND --out comparison."
        )
        if any(p.elsewhere is not None for p in parameters):
            said.append("Until then use the intervals for another record; they allow for what the model lacks.")
    elif verdict.wrong_law:
        said.append("Let the data choose the law of the errors: leave [discrepancy] out of the study.")
    if _hardly_known(parameters):
        said.append(
            "To learn more of what the data say little of, measure another channel or a stronger motion, or take its prior "
            "from tests."
        )
    if not said:
        with_it = "[[prediction.records]] in a study or predict(record) in Python"
        said.append(
            f"Use it: what other records do to the structure is below; further ones come with {with_it}."
            if material.other_records
            else f"Use it: predict what other records do to the structure, with {with_it}."
        )
        said.append("If there is another measurement, add it as a further observation, or see whether it is predicted.")
    return said


def _hardly_known(parameters: list[LearntParameter]) -> list[LearntParameter]:
    """Parameters of which the posterior is about what the prior was; one that the data have moved is not among them."""
    return [p for p in parameters if p.narrowed < LITTLE and p.prior[0] <= p.mean <= p.prior[1]]


def _listed(names: list[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
