"""Stage: deterministic calibrations, for comparison with the Bayesian calibration."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from structid.core.journal import write_then_rename
from structid.inference.likelihood.posterior import Posterior
from structid.optimize.interior_point import interior_point
from structid.optimize.minima import Minimum, OptimizeResult, Searches
from structid.optimize.pattern_search import pattern_search
from structid.study.building.built_study import BuiltStudy
from structid.study.stages.stage import StudyStage, StudyState, Workplace

SEARCHES: dict[str, Callable[..., OptimizeResult]] = {
    "pattern_search": pattern_search,
    "interior_point": interior_point,
}
"""Search methods by name."""


def _run(state: StudyState, workplace: Workplace) -> StudyState:
    study = state.study
    results = {name.replace("_", " "): _search(name, study, workplace) for name in study.search_methods}
    return state.having(Searches, Searches(results))


def _search(method: str, study: BuiltStudy, workplace: Workplace) -> OptimizeResult:
    section, stored, name = study.file.deterministic, workplace.folder / f"{method}.json", method.replace("_", " ")
    # A continued calibration has another surrogate, with other minima.
    settings = {**section.model_dump(mode="json"), "posterior": study.sampled.content_hash}
    if stored.is_file() and json.loads(stored.read_text())["settings"] == settings:
        return _read_search(stored, study.sampled)
    with workplace.stage(name) as progress, workplace.timings.measured(name):
        optimum = SEARCHES[method](
            study.sampled.misfit,
            bounds=_searched_range(study),
            constraints=section.constraints,
            starts=section.starts,
            seed=study.file.seed,
            progress=progress,
        )
    optimum.to_text(workplace.folder / f"{method}.txt")
    _write_search(stored, optimum, settings)
    return optimum


def _searched_range(study: BuiltStudy) -> dict[str, tuple[float, float]] | None:
    """Bounds of the searches in SI, limited to the range of a surrogate: its response is constant outside its range."""
    stand_in, given = study.sampled.model.stand_in, study.search_bounds
    if stand_in is None:
        return given
    bounds = dict(given or {})
    for name, (low, high) in stand_in.search_range().items():
        least, most = bounds.get(name, (low, high))
        bounds[name] = (max(least, low), min(most, high))
    return bounds


def _write_search(path: Path, result: OptimizeResult, settings: dict[str, Any]) -> None:
    content = {
        "settings": settings,
        "method": result.method,
        "evaluations": result.evaluations,
        "scale": result.scale,
        "ends": result.ends.tolist(),
        "values": result.values.tolist(),
        "minima": [
            {"theta": m.theta.tolist(), "value": m.value, "starts": m.starts, "on_boundary": m.on_boundary}
            for m in result.minima
        ],
    }
    write_then_rename(path, json.dumps(content, indent=2).encode())


def _read_search(path: Path, posterior: Posterior) -> OptimizeResult:
    content = json.loads(path.read_text())
    space = posterior.model_space
    minima = tuple(
        Minimum(np.array(m["theta"]), m["value"], m["starts"], tuple(m["on_boundary"])) for m in content["minima"]
    )
    return OptimizeResult(
        content["method"],
        space.names,
        minima,
        content["evaluations"],
        content["scale"],
        np.array(content["ends"]),
        np.array(content["values"]),
        space.units,
        space.factors,
    )


STAGE = StudyStage(Searches, lambda state: state.study.posterior is not None, _run)
