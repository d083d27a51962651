"""Run a study from its file to its report; everything that is finished is on disk, and a killed run goes on from there."""

from __future__ import annotations

import json
import shutil
import time
import tomllib
import warnings
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from structid.calibration.calibration_result import CalibrationResult
from structid.calibration.sequential import Plan, calibrate
from structid.campaign.executors import kept_open, run_map
from structid.campaign.runner import Campaign
from structid.campaign.store import CALIBRATION_FOLDER, CAMPAIGN_RUNS, open_runs
from structid.errors import InputError, StructidWarning
from structid.inference.likelihood.posterior import Posterior
from structid.inference.sample import sample
from structid.inference.sampling_result import SamplingResult
from structid.journal import compare_identity, differences, write_then_rename
from structid.models.face import Progress
from structid.optimize import interior_point, pattern_search
from structid.optimize.minima import Minimum, OptimizeResult
from structid.report.content import ReportContent
from structid.report.page import PAGE, write_campaign_report, write_report
from structid.runs import Runs
from structid.streams import Purpose, derived_seed
from structid.study.build import BuiltStudy, build
from structid.study.schema import StudyFile, parse_study, read_study
from structid.study.surrogate import fitted_surrogate, surrogate_settings
from structid.surrogates.face import Surrogate
from structid.surrogates.registry import load_surrogate

Stage = Callable[[str], Any]
"""Opens a progress bar for a stage: a context manager that gives a `Progress`."""

_SEARCHES: dict[str, Callable[..., OptimizeResult]] = {
    "pattern_search": pattern_search,
    "interior_point": interior_point,
}
IDENTITY = "identity.json"
"""File of a study's folder that says what it depends on."""

_STUDY, _TIMINGS, _INPUTS = "study.toml", "timings.json", "inputs"
_CHAINS, _SCRATCH = "chains.h5", "scratch"
_SURROGATE, _VALIDATION = "surrogate.h5", "validation.h5"


@contextmanager
def silent(_: str) -> Iterator[Progress | None]:
    """Stage without a progress bar.

    Yields
    ------
    None
        No progress wanted.
    """
    yield None


@dataclass(frozen=True, eq=False)
class Outcome:
    """What a run of a study leaves.

    Parameters
    ----------
    result : SamplingResult or None
        Draws and verdict; None for a study without an observation.
    searches : dict of str to OptimizeResult
        Deterministic calibrations by method.
    report : Path
        The page.
    runs : Runs or None
        The campaign's.
    surrogate : Surrogate or None
        What stood in for the model, validated.
    calibration : CalibrationResult or None
        Certificate and rounds, where the study asks for them.
    """

    result: SamplingResult | None
    searches: dict[str, OptimizeResult]
    report: Path
    runs: Runs | None = None
    surrogate: Surrogate | None = None
    calibration: CalibrationResult | None = None

    @property
    def trusted(self) -> bool:
        """Whether its numbers may be believed: converged, and certified where that was asked for."""
        certified = self.calibration is None or self.calibration.trusted
        return certified and (self.result is None or self.result.verdict().converged)


def load(path: str | Path) -> BuiltStudy:
    """Read and build a study file.

    Parameters
    ----------
    path : path-like
        The file.

    Returns
    -------
    BuiltStudy
        Ready to run.
    """
    return build(read_study(path), Path(path).resolve().parent)


def run_study(
    path: str | Path,
    out: str | Path,
    resume: bool = False,
    stage: Stage = silent,
    executor: Any = None,
    retry: bool = False,
    adopt: bool = False,
) -> Outcome:
    """Run a study.

    Parameters
    ----------
    path : path-like
        The study file.
    out : path-like
        Folder for everything it makes.
    resume : bool
        Go on with what is in that folder.
    stage : callable
        Opens a progress bar for a named stage.
    executor : None, str or object
        Where the runs of an external model are done; see `Campaign.run`.
    retry : bool
        Do runs of the campaign again that failed before.
    adopt : bool
        Keep the campaign's runs of another version of the model; see `Campaign.run`.

    Returns
    -------
    Outcome
        Result, searches, report, runs.

    Raises
    ------
    InputError
        If the file is wrong, or the folder holds something else; nothing is written then.
    """
    study = load(path)
    folder = Path(out)
    with kept_open(study.model, executor) as workers:  # an executor that is not there is said before a folder is taken
        _claim(folder, study, Path(path), resume or retry or adopt, adopt)
        return _work(study, folder, stage, workers, retry, adopt)


def _sampled(folder: Path) -> bool:
    """Whether there are draws, of a plain sampling or of a calibration."""
    return (folder / _CHAINS).is_file() or any((folder / CALIBRATION_FOLDER).glob("chains_*.h5"))


def report_again(folder: str | Path, stage: Stage = silent) -> Outcome:
    """Write the report again from what is stored.

    Parameters
    ----------
    folder : path-like
        A folder `run_study` has filled.
    stage : callable
        Opens a progress bar for a named stage.

    Returns
    -------
    Outcome
        The same result and a fresh page.

    Raises
    ------
    InputError
        If the folder holds no finished study.
    """
    folder = Path(folder)
    file, told = _stored_study(folder)
    if not file.observation:  # runs alone: the solver is not needed, and may have changed or gone
        return _runs_report(open_runs(folder / CAMPAIGN_RUNS), file, folder, _Timings(folder / _TIMINGS))
    return _work(_rebuilt(folder, file, told), folder, stage)


def stored_outcome(folder: str | Path, stage: Stage = silent) -> Outcome:
    """Read back what a study has found, without writing anything.

    Parameters
    ----------
    folder : path-like
        A folder `run_study` has filled.
    stage : callable
        Opens a progress bar for a named stage.

    Returns
    -------
    Outcome
        The same result.

    Raises
    ------
    InputError
        If the folder holds no finished calibration.
    """
    folder = Path(folder)
    return _work(_rebuilt(folder, *_stored_study(folder)), folder, stage, page=False)


def _stored_study(folder: Path) -> tuple[StudyFile, dict[str, Any]]:
    """The study in a folder, its file names turned to the copies, and what identifies it."""
    identity = folder / IDENTITY
    if not identity.is_file() or not (_sampled(folder) or (folder / CAMPAIGN_RUNS).is_file()):
        raise InputError(
            f"{folder}",
            "it holds no finished study",
            "a folder that structid run has filled",
            "Finish it first: structid run STUDY.toml --out DIR --resume.",
        )
    told = json.loads(identity.read_text())
    return _with_kept_inputs(folder, told["inputs"]), told


def _rebuilt(folder: Path, file: StudyFile, told: dict[str, Any]) -> BuiltStudy:
    """The study that has been sampled in a folder."""
    if not _sampled(folder):
        raise InputError(
            f"{folder}", "its sampling has not begun", "a folder that structid run has finished",
            "Finish it first: structid run STUDY.toml --out DIR --resume.",
        )  # fmt: skip
    study = build(file, folder / _INPUTS, Path(told["folder"]))
    compare_identity(folder, told["study"], study.identity)
    return study


def _claim(folder: Path, study: BuiltStudy, path: Path, resume: bool, adopt: bool) -> None:
    """Take a folder for this study, or refuse it; nothing in it is touched when it is refused."""
    told = folder / IDENTITY
    if told.is_file():
        found = json.loads(told.read_text())["study"]
        if not (adopt and differences(found, study.identity) == ["model"]):
            compare_identity(folder, found, study.identity)
        if not resume:
            raise InputError(
                f"--out {folder}",
                "it already holds this study",
                "an empty or new folder",
                "Add --resume to go on with it, or name another folder.",
            )
    elif folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError(
            f"--out {folder}", "it is not empty and holds no study", "an empty or new folder", "Name another folder."
        )
    folder.mkdir(parents=True, exist_ok=True)
    if path.resolve() != (folder / _STUDY).resolve():
        shutil.copyfile(path, folder / _STUDY)
    inputs = _keep_inputs(study, folder)
    identity = {
        "study": study.identity, "name": study.file.name, "inputs": inputs, "folder": str(study.folder),
    }  # fmt: skip
    write_then_rename(told, json.dumps(identity, indent=2).encode())


def _keep_inputs(study: BuiltStudy, folder: Path) -> dict[str, str]:
    """Copy every file the study reads into its folder, so that the report needs nothing else; old names to new ones."""
    kept: dict[str, str] = {}
    for name in dict.fromkeys(_file_names(study.file.model_dump(exclude={"model"}))):
        kept[name] = f"{len(kept)}/{Path(name).name}"
        target = folder / _INPUTS / kept[name]
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(study.folder / name, target)
    return kept


def _file_names(content: Any) -> Iterator[str]:
    """Every value of a key ``file``, however deep."""
    if isinstance(content, dict):
        for key, value in content.items():
            if key == "file" and isinstance(value, str):
                yield value
            else:
                yield from _file_names(value)
    elif isinstance(content, (list, tuple)):
        for value in content:
            yield from _file_names(value)


def _with_kept_inputs(folder: Path, inputs: dict[str, str]) -> StudyFile:
    """Read the stored study with its file names turned to the copies."""

    def turned(content: Any) -> Any:
        if isinstance(content, dict):
            return {k: inputs[v] if k == "file" and isinstance(v, str) else turned(v) for k, v in content.items()}
        return [turned(v) for v in content] if isinstance(content, list) else content

    path = folder / _STUDY
    return parse_study(turned(tomllib.loads(path.read_text(encoding="utf-8"))), str(path))


def _work(
    study: BuiltStudy,
    folder: Path,
    stage: Stage,
    executor: Any = None,
    retry: bool = False,
    adopt: bool = False,
    page: bool = True,
) -> Outcome:
    timings = _Timings(folder / _TIMINGS)
    study = study.working_in(folder.resolve() / _SCRATCH)
    if study.plan is not None:
        return _certified(study, study.plan, folder, stage, timings, executor, page)
    runs = _campaign(study, folder, stage, timings, executor, retry, adopt)
    surrogate = _surrogate(study, runs, folder, stage, timings, executor)
    if study.posterior is None:
        assert runs is not None
        return _runs_report(runs, study.file, folder, timings, surrogate)
    with run_map(study.model, executor) as map_of_runs:
        study = replace(study, posterior=study.posterior.mapped_by(map_of_runs))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", StructidWarning)  # draws outside a surrogate's range are in the verdict
            return _calibration(study, folder, stage, timings, runs, surrogate, page)


def _runs_report(
    runs: Runs, file: StudyFile, folder: Path, timings: _Timings, surrogate: Surrogate | None = None
) -> Outcome:
    settings = (folder / _STUDY).read_text(encoding="utf-8")
    if surrogate is None and (folder / _SURROGATE).is_file():
        surrogate = load_surrogate(folder / _SURROGATE)
    page = write_campaign_report(runs, file.title or file.name, settings, folder, timings.seconds, surrogate)
    return Outcome(None, {}, page, runs, surrogate)


def _surrogate(
    study: BuiltStudy, runs: Runs | None, folder: Path, stage: Stage, timings: _Timings, executor: Any
) -> Surrogate | None:
    """Fit the surrogate the study asks for, and validate it on runs it has not seen; or read it back."""
    section = study.file.surrogate
    if not study.has_surrogate:
        return None
    assert runs is not None
    with stage("fitting the surrogate") as progress, timings.measured("fitting the surrogate", once=True):
        surrogate = fitted_surrogate(section, runs, folder / _SURROGATE, progress)
    if surrogate.validation is None:
        # A stream of its own: the design may be a random one of the same seed.
        seed = derived_seed(study.file.seed, Purpose.VALIDATION_DESIGN)
        design = study.space.sample(study.validation_runs, seed, "random")
        campaign = Campaign(study.model, study.campaign_records, design, folder / _VALIDATION, assignment="cycle")
        with stage("true runs to validate it") as progress, timings.measured("true runs to validate it", goes_on=True):
            unseen = campaign.run(executor, progress=progress)
        with stage("validating the surrogate") as progress, timings.measured("validating the surrogate"):
            surrogate.validate(unseen, progress)
        surrogate.save(folder / _SURROGATE)
    return surrogate


def _campaign(
    study: BuiltStudy, folder: Path, stage: Stage, timings: _Timings, executor: Any, retry: bool, adopt: bool
) -> Runs | None:
    """Do the true runs the study asks for, or read them back."""
    if study.campaign is None:
        return None
    campaign = Campaign(study.model, study.campaign_records, study.campaign, folder / CAMPAIGN_RUNS, assignment="cycle")
    attempts = 1 if study.file.campaign is None else study.file.campaign.attempts
    with stage("true runs") as progress, timings.measured("true runs", goes_on=True):
        return campaign.run(executor, retry=retry, attempts=attempts, adopt=adopt, progress=progress)


def _calibration(
    study: BuiltStudy,
    folder: Path,
    stage: Stage,
    timings: _Timings,
    runs: Runs | None,
    surrogate: Surrogate | None,
    page: bool,
) -> Outcome:
    true_posterior = study.sampled
    if surrogate is not None and study.sampler.exact:
        study = replace(study, sampler=study.sampler.proposing_by(surrogate))
    elif surrogate is not None:
        try:
            study = replace(study, posterior=true_posterior.on(surrogate))
        except InputError:
            assert runs is not None
            _runs_report(runs, study.file, folder, timings, surrogate)  # so that its validation can be looked at
            raise
    searches = _deterministic(study, folder, stage, timings)
    with stage("sampling") as progress, timings.measured("sampling"):
        result = sample(study.sampled, study.sampler, study.file.seed, folder / _CHAINS, progress=progress)
    timings.put("sampling", result.seconds)
    if page:
        _report(study, result, searches, folder, stage, timings, runs, true_posterior)
    return Outcome(result, searches, folder / PAGE, runs, surrogate)


def _certified(
    study: BuiltStudy, plan: Plan, folder: Path, stage: Stage, timings: _Timings, executor: Any, page: bool
) -> Outcome:
    """Calibrate by a surrogate that true runs certify, and report it."""
    posterior = study.sampled
    with run_map(study.model, executor) as map_of_runs:
        study = replace(study, posterior=posterior.mapped_by(map_of_runs))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", StructidWarning)  # what a surrogate warns of is in the verdict
            with _Told(stage, timings) as told:
                found = calibrate(
                    study.model,
                    posterior.model_space,
                    posterior.observations,
                    surrogate_settings(study.file.surrogate),
                    posterior.discrepancy,
                    plan=plan,
                    sampler=study.sampler if "sampler" in study.file.model_fields_set else None,
                    seed=study.file.seed,
                    store=folder / CALIBRATION_FOLDER,
                    executor=executor,
                    progress=told,
                )
            under = study if found.exact else replace(study, posterior=study.sampled.on(found.surrogate))
            searches = _deterministic(under, folder, stage, timings)
            if page:
                _report(under, found.sampling, searches, folder, stage, timings, found.runs, study.sampled, found)
    return Outcome(found.sampling, searches, folder / PAGE, found.runs, found.surrogate, found)


class _Told:
    """Opens a bar for each thing that a calibration says it is doing, and adds up its time.

    Parameters
    ----------
    stage : callable
        Opens a progress bar for a named stage.
    timings : _Timings
        Keeps the times.
    """

    def __init__(self, stage: Stage, timings: _Timings) -> None:
        self._stage, self._timings, self._doing = stage, timings, ""
        self._open, self._bar = ExitStack(), None

    def __enter__(self) -> _Told:
        return self

    def __exit__(self, *exception: object) -> None:
        self._open.close()

    def __call__(self, what: str, done: int, total: int) -> None:
        if what != self._doing:
            self._open.close()
            self._doing = what
            self._bar = self._open.enter_context(self._stage(what))
            self._open.enter_context(self._timings.measured(what, goes_on=True))
        if self._bar is not None:
            self._bar(done, total)


def _report(
    study: BuiltStudy,
    result: SamplingResult,
    searches: dict[str, OptimizeResult],
    folder: Path,
    stage: Stage,
    timings: _Timings,
    runs: Runs | None,
    true_posterior: Posterior,
    calibration: CalibrationResult | None = None,
) -> None:
    """Predict, draw and write the page and the netCDF file."""
    with stage("predicting and drawing") as progress, timings.measured("predicting and drawing"):
        content = ReportContent.gather(
            result,
            searches,
            study.raw_record,
            study.record,
            truths=study.truths,
            true_values=study.true_values,
            other_records=study.other_records,
            prediction_draws=study.file.prediction.draws,
            title=study.file.title or study.file.name,
            settings=(folder / _STUDY).read_text(encoding="utf-8"),
            runs=runs,
            true_posterior=true_posterior,
            calibration=calibration,
        )
        steps = [*content.drawings(folder / "figures"), lambda: result.to_netcdf(folder / "posterior.nc")]
        for done, step in enumerate(steps, start=1):
            step()
            if progress is not None:
                progress(done, len(steps))
    write_report(content, folder, timings.seconds)


class _Timings:
    """Seconds of every stage, kept on disk: a stage that was read back from disk keeps the time it once took."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.seconds: dict[str, float] = json.loads(path.read_text()) if path.is_file() else {}

    def put(self, name: str, seconds: float) -> None:
        self.seconds[name] = seconds
        write_then_rename(self.path, json.dumps(self.seconds, indent=2).encode())

    @contextmanager
    def measured(self, name: str, goes_on: bool = False, once: bool = False) -> Iterator[None]:
        """Measure a stage; one that goes on where it was stopped adds to what it took before, one done once keeps that."""
        before = self.seconds.get(name, 0.0)
        began = time.perf_counter()
        yield
        if not (once and before):
            self.put(name, (before if goes_on else 0.0) + time.perf_counter() - began)


def _deterministic(study: BuiltStudy, folder: Path, stage: Stage, timings: _Timings) -> dict[str, OptimizeResult]:
    """Run or read back the deterministic calibrations."""
    section = study.file.deterministic
    found: dict[str, OptimizeResult] = {}
    for method in study.search_methods:
        stored = folder / f"{method}.json"
        name = method.replace("_", " ")
        # A calibration that went on has another surrogate, whose minima are others.
        settings = {**section.model_dump(mode="json"), "posterior": study.sampled.content_hash}
        if stored.is_file() and json.loads(stored.read_text())["settings"] == settings:
            found[name] = _read_search(stored, study.sampled)
            continue
        with stage(name) as progress, timings.measured(name):
            found[name] = _SEARCHES[method](
                study.sampled.misfit,
                bounds=_searched_range(study),
                constraints=section.constraints,
                starts=section.starts,
                seed=study.file.seed,
                progress=progress,
            )
        found[name].to_text(folder / f"{method}.txt")
        _write_search(stored, found[name], settings)
    return found


def _searched_range(study: BuiltStudy) -> dict[str, tuple[float, float]] | None:
    """Bounds of the searches in SI: the study's, within the range of a surrogate, which beyond it responds as at the edge."""
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
