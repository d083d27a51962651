"""Compare studies of the same measurement: which model class do the data favour."""

from __future__ import annotations

import json
import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np

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
from structid.study.folder import IDENTITY
from structid.study.run import StudyOutcome, stored_outcome
from structid.study.timings import Stage, silent

DRAWS = 1000
"""Posterior draws that predict what is left out."""
PREDICTED = 200
"""Posterior draws behind the bands."""
_EVIDENCE = "evidence.h5"


def compare_studies(
    folders: Sequence[str | Path], out: str | Path | None = None, stage: Stage = silent
) -> tuple[Comparison, Path | None]:
    """Compare finished studies of the same measurement."""
    paths = [Path(f) for f in folders]
    if len(paths) < 2:
        raise InputError("compare", f"{len(paths)} folder", "two or more that structid run has filled")
    _check_same_measurement(paths)
    return compare_outcomes(paths, [stored_outcome(path, stage) for path in paths], out, stage)


def compare_outcomes(
    paths: Sequence[Path], outcomes: Sequence[StudyOutcome], out: str | Path | None = None, stage: Stage = silent
) -> tuple[Comparison, Path | None]:
    """Compare what studies of the same measurement have found."""
    classes = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", StructidWarning)  # what a surrogate warns of is in its own study
        for path, name, outcome in zip(paths, _names(paths), outcomes, strict=True):
            with stage(f"comparing {name}"):
                classes.append(_compared(path, name, outcome))
        material = ComparisonMaterial(tuple(classes))
        if out is None:
            return material.comparison, None
        with stage("drawing") as progress:
            return material.comparison, write_comparison(material, Path(out), progress)


def _check_same_measurement(paths: Sequence[Path]) -> None:
    seen = {}
    for path in paths:
        told = path / IDENTITY
        if not told.is_file():
            raise InputError(f"{path}", "it holds no study", "a folder that structid run has filled")
        study = json.loads(told.read_text())["study"]
        if "observation" not in study:
            raise InputError(f"{path}", "a study without an observation", "studies that calibrate to a measurement")
        seen[path] = study["observation"]
    others = [p for p in paths if seen[p] != seen[paths[0]]]
    if others:
        raise InputError(
            "compare",
            f"{paths[0]} and {others[0]}, which are of different measurements",
            "studies of one and the same measurement",
            "Evidence says nothing across measurements: give both studies the same record, channels, values and instruments.",
        )


def _names(paths: Sequence[Path]) -> list[str]:
    """Names of the studies; of their folders where those are the same. A page shows words, and no underscores."""
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
    """Share of all measured values inside their 90 % bands."""
    inside = []
    for observation, prediction in zip(observations, predictions, strict=True):
        low, high = prediction.band(0.9, discrepancy=True)
        inside.append(((observation.values >= low) & (observation.values <= high)).ravel())
    return float(np.mean(np.concatenate(inside)))


def _evidence(path: Path, outcome: StudyOutcome) -> Evidence | None:
    """The sampler's evidence. If it has none, the evidence of tempered SMC on the same posterior, where that is fast."""
    result, calibration = outcome.result, outcome.calibration
    assert result is not None and isinstance(result.target, Posterior)
    found = result.log_evidence
    if found is None:
        target = result.target if calibration is None else calibration.posterior.on(calibration.surrogate)
        if target.costs_runs:
            return None
        found = sample(target, SMC(), result.seed, path / _EVIDENCE).log_evidence
    return found if calibration is None or found is None else calibration.corrected(found)
