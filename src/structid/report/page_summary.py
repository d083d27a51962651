"""The summary at the top of a calibration's page: the parameters, their reliability, and the next steps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from structid.core.notebook import ShownAsText
from structid.core.wording import listed
from structid.figures.style import pretty
from structid.inference.model_comparison.comparison import aligned
from structid.report.material.comparison_material import ComparedClass, ComparisonMaterial
from structid.report.material.cyclic_material import CyclicMaterial
from structid.report.material.learnt_parameters import LITTLE, LearntParameter, learnt_parameters
from structid.report.material.material import PosteriorMaterial
from structid.report.tables import percent
from structid.surrogates.base import Surrogate

Trust = Literal["good", "doubtful", "bad"]
"""Rating of the sampling, the surrogate or the model."""

ORDER: tuple[Trust, ...] = ("good", "doubtful", "bad")

MARKS: dict[Trust, str] = {"good": "✓", "doubtful": "!", "bad": "✗"}

TIED = 0.9
"""Absolute correlation above which the page reports that two parameters are determined jointly better than separately."""


@dataclass(frozen=True)
class Believed:
    """Assessment of the sampling, the surrogate or the model."""

    about: str  # subject
    trust: Trust  # ``"good"``, ``"doubtful"`` or ``"bad"``
    said: str  # the assessment, in a few words


@dataclass(frozen=True)
class PageSummary(ShownAsText):
    """The summary of a page."""

    parameters: list[LearntParameter]  # parameters of the model
    believed: list[Believed]  # assessments of the sampling, the surrogate and the model
    unsaid: list[str]  # sentences on the parameters that the data do not determine
    further: list[str]  # sentences on the next steps, the most important first

    @property
    def elsewhere(self) -> bool:
        """Whether a parameter has a different interval for another record."""
        return any(p.elsewhere is not None for p in self.parameters)

    @property
    def truths(self) -> tuple[int, int] | None:
        """Number of true values inside the recommended intervals, and number of known true values; None if none is known."""
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
        """The worst of the assessments."""
        return max((b.trust for b in self.believed), key=ORDER.index)


def page_summary(material: PosteriorMaterial) -> PageSummary:
    """Build the summary of a calibration."""
    parameters = learnt_parameters(material)
    return PageSummary(parameters, _answers(material), _unsaid(material, parameters), _further(material, parameters))


def cyclic_summary(material: CyclicMaterial) -> tuple[list[Believed], list[str]]:
    """Build the summary of a cyclic test: assessments of the sampling and of the law, and the next steps."""
    choice = material.choice
    verdict, held_out = choice.result.verdict(), material.held_out
    sampling = (
        Believed("Sampling", "good", "converged; independent ensembles agree")
        if verdict.converged
        else Believed("Sampling", "bad", "not converged: do not use the parameters")
    )
    left = f"it leaves {percent(choice.least_squares)} of the variance of the force unexplained"
    if verdict.converged and verdict.wrong_model:
        law = Believed("Law", "bad", f"the best of these laws, but wrong for these data; {left}")
    elif verdict.converged and not verdict.doubt:
        law = Believed("Law", "good", f"no evidence against it; {left}")
    else:
        law = Believed("Law", "doubtful", f"the residuals contradict the error model; {left}")
    believed = [sampling, law]
    if held_out is not None:
        trust: Trust = "good" if held_out.coverage >= 0.8 else "doubtful"
        words = f"the 90 % band holds {held_out.coverage:.0%} of the samples of the last half-cycles, predicted from the first"
        believed.append(Believed("Prediction", trust, words))
    further = []
    if not verdict.converged:
        further.append("Choose among fewer laws, or thin the samples of the test: the draws have not converged.")
    if law.trust != "good":
        further.append(
            "Use predictions with their band, which contains the error of the model. The parameters give the law's best fit. They "
            "are not properties of the specimen."
        )
    if not material.predictions:
        further.append(
            "Predict the force under other displacements: add a [[prediction]] table, or choice.predict(displacement)."
        )
    if not material.responses:
        further.append(
            "Use the specimen dynamically: add a [dynamics] table with its mass and records, or choice.oscillator(mass)."
        )
    return believed, further


def comparison_summary(material: ComparisonMaterial) -> tuple[list[Believed], list[str]]:
    """Build the summary of a comparison."""
    believed = [_of_a_class(one) for one in material.classes]
    unfinished = [one.name for one in material.classes if not one.figures.trusted]
    best = material.best
    if unfinished:
        return believed, [
            f"Finish {listed(unfinished)} first: structid run … --resume. Until then, the ranking may change."
        ]
    verdict = best.material.result.verdict()
    if verdict.wrong_model:
        return believed, [
            f"{best.name} is the best of these classes, but still wrong for the data. Check the residuals in its report, and add "
            "the missing behaviour to the model. Then calibrate it to the same measurement and repeat the comparison."
        ]
    return believed, [
        f"Use {best.name}: its parameters, intervals and predictions are below and in its own report.",
        "If another class is plausible, calibrate it to the same measurement and repeat the comparison.",
    ]


def _of_a_class(one: ComparedClass) -> Believed:
    """Rate a model class by the worst rating of its sampling, surrogate and model."""
    answers = _answers(one.material)
    worst = max(answers, key=lambda answer: ORDER.index(answer.trust))
    warning = "" if one.figures.trusted else "do not trust its numbers; "
    return Believed(one.name, worst.trust, warning + answers[-1].said)


def _answers(material: PosteriorMaterial) -> list[Believed]:
    """Assess the sampling, the surrogate and the model."""
    return [_sampling(material), *_surrogate(material), *_model(material)]


def _sampling(material: PosteriorMaterial) -> Believed:
    verdict = material.result.verdict()
    if not verdict.converged:
        return Believed("Sampling", "bad", "not converged: do not use these numbers")
    return Believed("Sampling", "good", "converged; independent ensembles agree")


def _surrogate(material: PosteriorMaterial) -> list[Believed]:
    """Assess the surrogate by its certificate or its validation; empty if the model itself was sampled."""
    if material.result.cost is not None:
        return [
            Believed("Surrogate", "good", "used only for proposals; the model itself accepted or rejected each step")
        ]
    if material.calibration is None:
        validated = Surrogate in material.results
        return [Believed("Surrogate", "doubtful", "validated, but not certified")] if validated else []
    certificate = material.calibration.certificate
    if certificate.certified:
        runs = f"{certificate.true_runs} model runs"
        bound = f"the error of every mean is at most {certificate.mean_bound.max():.2g} standard deviations"
        return [Believed("Surrogate", "good", f"certified by {runs}: {bound}")]
    if certificate.usable:
        return [Believed("Surrogate", "doubtful", "usable with re-weighting: these numbers are corrected")]
    return [Believed("Surrogate", "bad", "not certified: do not use these numbers")]


def _model(material: PosteriorMaterial) -> list[Believed]:
    verdict = material.result.verdict()
    if not verdict.converged:
        return []
    left = f"its best prediction leaves {percent(verdict.unexplained)} of the measured variance unexplained"
    if verdict.wrong_model:
        return [Believed("Model", "bad", f"wrong for these data; {left}")]
    if verdict.wrong_error_model:
        return [Believed("Model", "doubtful", f"the residuals contradict the error model; {left}")]
    return [Believed("Model", "good", f"no evidence against it; {left}")]


def _unsaid(material: PosteriorMaterial, parameters: list[LearntParameter]) -> list[str]:
    """List the parameters that the data do not determine, given the model."""
    if not material.result.verdict().converged:
        return []
    sentences = []
    little = [pretty(p.name) for p in _hardly_known(parameters)]
    if little:
        sentences.append(
            f"The data hardly constrain {listed(little)}: {'its' if len(little) == 1 else 'their'} posterior is close to the "
            "prior."
        )
    adrift = [pretty(p.name) for p in parameters if p.unknown_elsewhere and pretty(p.name) not in little]
    if adrift:
        sentences.append(
            f"For another record, the data hardly constrain {listed(adrift)}: during the measured record, "
            f"{'it drifts' if len(adrift) == 1 else 'they drift'} by about the width of the prior."
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
        which = "this pair" if len(tied) == 1 else "these pairs"
        sentences.append(
            f"{'; '.join(pairs)}: the data determine {which} jointly better than separately (correlation {sizes})."
        )
    return sentences or ["None: the data constrain every parameter separately."]


def _further(material: PosteriorMaterial, parameters: list[LearntParameter]) -> list[str]:
    """List the next steps. A step that is needed before the numbers are valid is listed alone."""
    verdict, calibration = material.result.verdict(), material.calibration
    exact = material.result.cost is not None
    if not verdict.converged:
        return ["Continue sampling: increase steps or particles in the study file, then rerun with --resume."]
    if calibration is not None and not (calibration.certificate.usable or exact):
        enough = calibration.enough_to_go_on
        more = f"Allow more model runs: set true_runs = {enough} or more, then rerun with --resume."
        return [calibration.hint or more]
    # A prior that the data contradict comes before all other problems.
    sentences = [
        f"{warned.said[:1].upper()}{warned.said[1:]}. {warned.cure}" for warned in verdict.against_priors if warned.cure
    ]
    if verdict.another_size:
        sentences.append(
            "Check the units of the measurement, the record and the priors: the best prediction and the measurement differ too "
            "much in size. Correct the units, and rerun in another folder."
        )
    elif verdict.wrong_model:
        sentences.append(
            "Do not use these parameters as properties of the structure. Add the missing behaviour to the model (for example a "
            "sharper or softer yield, degradation, pinching, an instrument offset), and calibrate it to the same measurement. Then "
            "compare the two models: structid compare FIRST SECOND --out comparison."
        )
        if any(p.elsewhere is not None for p in parameters):
            sentences.append("Until then, use the intervals for another record: they allow for the model error.")
    elif verdict.wrong_error_model:
        sentences.append("Let the data choose the error model: remove [discrepancy] from the study file.")
    if _hardly_known(parameters):
        sentences.append(
            "To determine the poorly constrained parameters, measure another channel or a stronger response, or take their "
            "priors from tests."
        )
    if not sentences:
        by_what = "[[prediction.records]] in a study file or predict(record) in Python"
        sentences.append(
            f"Use the result: predictions for other records are below. Add further records with {by_what}."
            if material.other_records
            else f"Use the result: predict the response to other records with {by_what}."
        )
        sentences.append(
            "If there is another measurement, add it as an observation, or check whether the model predicts it."
        )
    return sentences


def _hardly_known(parameters: list[LearntParameter]) -> list[LearntParameter]:
    """Parameters with a posterior about as wide as the prior, and a mean inside the prior's 90 % interval."""
    return [p for p in parameters if p.narrowed < LITTLE and p.prior[0] <= p.mean <= p.prior[1]]
