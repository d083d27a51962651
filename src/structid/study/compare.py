"""Comparison of studies of the same measurement, to find the model class that the data favour."""

from __future__ import annotations

import json
import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from structid.calibration.calibration_result import CalibrationResult
from structid.core.errors import InputError, StructidWarning
from structid.inference.likelihood.posterior import Posterior
from structid.inference.model_comparison.comparison import Comparison, ModelClass, leave_out
from structid.inference.prediction.prediction import Prediction, predict
from structid.inference.sample import sample
from structid.inference.sampling.base import Evidence
from structid.inference.sampling.smc.smc import SMC
from structid.observation import Observation
from structid.report.material.comparison_material import ComparedClass, ComparisonMaterial
from structid.report.page import write_comparison
from structid.study.folder_layout import IDENTITY
from structid.study.run import StudyOutcome, stored_outcome
from structid.study.timings import Stage, silent

DRAWS = 1000
"""Number of posterior draws that predict held-out segments of the history."""
PREDICTED = 200
"""Number of posterior draws for the prediction bands."""
_EVIDENCE = "evidence.h5"


def compare_studies(
    folders: Sequence[str | Path], out: str | Path | None = None, stage: Stage = silent
) -> tuple[Comparison, Path | None]:
    """Compare finished studies of the same measurement."""
    paths = [Path(f) for f in folders]
    if len(paths) < 2:
        raise InputError("compare", f"{len(paths)} folder", "two or more output folders of structid run")
    _check_same_measurement(paths)
    return compare_outcomes(paths, [stored_outcome(path, stage) for path in paths], out, stage)


def compare_outcomes(
    paths: Sequence[Path], outcomes: Sequence[StudyOutcome], out: str | Path | None = None, stage: Stage = silent
) -> tuple[Comparison, Path | None]:
    """Compare the results of studies of the same measurement."""
    classes = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", StructidWarning)  # each report contains the warnings of its surrogate
        for path, name, outcome in zip(paths, _names(paths), outcomes, strict=True):
            with stage(f"comparing {name}"):
                classes.append(_compared(path, name, outcome))
        material = ComparisonMaterial(tuple(classes))
        if out is None:
            return material.comparison, None
        with stage("drawing") as progress:
            return material.comparison, write_comparison(material, Path(out), progress)


def _check_same_measurement(paths: Sequence[Path]) -> None:
    observed = {}
    for path in paths:
        identity_file = path / IDENTITY
        if not identity_file.is_file():
            raise InputError(f"{path}", "it contains no study", "an output folder of structid run")
        study = json.loads(identity_file.read_text())["study"]
        if "observation" not in study:
            raise InputError(f"{path}", "a study without an observation", "a study with a measurement")
        observed[path] = study["observation"]
    others = [p for p in paths if observed[p] != observed[paths[0]]]
    if others:
        raise InputError(
            "compare",
            f"{paths[0]} and {others[0]}, which use different measurements",
            "studies of the same measurement",
            "Give both studies the same record, channels, values and instruments: evidence is comparable only then.",
        )


def _names(paths: Sequence[Path]) -> list[str]:
    """Names of the studies, or of their folders if two studies have the same name, with spaces for underscores."""
    names = [str(json.loads((p / IDENTITY).read_text())["name"]) for p in paths]
    return [name.replace("_", " ") for name in (names if len(set(names)) == len(names) else [p.name for p in paths])]


def _compared(path: Path, name: str, outcome: StudyOutcome) -> ComparedClass:
    result, material = outcome.result, outcome.material
    assert result is not None and material is not None
    posterior = material.posterior
    predictions = tuple(
        predict(posterior, result.thinned(PREDICTED), seed=result.seed, scaled=False, observation=index)
        for index in range(len(posterior.observations))
    )
    figures = ModelClass(
        name,
        _evidence(path, outcome),
        leave_out(posterior, result.thinned(PREDICTED if posterior.costs_runs else DRAWS)),
        posterior.dimension,
        result.verdict().unexplained,
        _share_inside(posterior.observations, predictions),
        outcome.trusted,
    )
    return ComparedClass(figures, material, predictions)


def _share_inside(observations: Sequence[Observation], predictions: Sequence[Prediction]) -> float:
    """Fraction of all measured values inside the 90 % bands."""
    inside = []
    for observation, prediction in zip(observations, predictions, strict=True):
        low, high = (observation.instrument.edge_at_samples(edge) for edge in prediction.band(0.9, discrepancy=True))
        inside.append(((observation.values >= low) & (observation.values <= high))[observation.is_measured])
    return float(np.mean(np.concatenate(inside)))


def _evidence(path: Path, outcome: StudyOutcome) -> Evidence | None:
    """Evidence from the sampler; otherwise from SMC on the same posterior if it is fast, else None."""
    result, calibration = outcome.result, outcome.results.get(CalibrationResult)
    assert result is not None and isinstance(result.target, Posterior)
    evidence = result.log_evidence
    if evidence is None:
        target = result.target if calibration is None else calibration.posterior.on(calibration.surrogate)
        if target.costs_runs:
            return None
        evidence = sample(target, SMC(), result.seed, path / _EVIDENCE).log_evidence
    return evidence if calibration is None or evidence is None else calibration.corrected(evidence)
