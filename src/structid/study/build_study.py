"""Build a complete study from a study file."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

from structid.core.by_type import ByType
from structid.core.channels import standard_unit
from structid.core.errors import InputError, StructidWarning, within
from structid.data_files.file_content import FileContent
from structid.ground_motion.record import GroundMotion
from structid.inference.likelihood.posterior import Posterior
from structid.mechanics.hysteretic_laws.base import HystereticLaw
from structid.models.base import Model
from structid.models.hysteretic.loop_lines import LoopLines
from structid.observation import Observation
from structid.probability.marginals import Gamma
from structid.probability.space import ParameterSpace
from structid.study.building.built_study import BuiltStudy
from structid.study.building.campaigns import build_campaign
from structid.study.building.checks import check_before_anything_is_written, check_tables
from structid.study.building.loops import build_loop
from structid.study.building.models import build_model
from structid.study.building.observations import build_discrepancy, build_observation
from structid.study.building.priors import parameter_prior, parameter_space
from structid.study.building.records import load_record, processed, read_record
from structid.study.building.samplers import build_plan, build_sampler
from structid.study.building.surrogates import surrogate_settings
from structid.study.open_law import check_open_law, law_is_open, laws_to_compare, motion_test_of, with_stand_in
from structid.study.schema.problems import StudyErrors
from structid.study.schema.study_file import StudyFile
from structid.study.stages import stage_list
from structid.study.study_reader import stage_tables, stands_alone


def build(file: StudyFile, folder: Path, solver_folder: Path | None = None) -> BuiltStudy:
    """Build a study, or report all problems of its file."""
    try:
        return _built(file, folder, solver_folder)
    except InputError as first:
        # Report this error together with all errors in independent parts, so that the user can correct them in one pass.
        problems = list(dict.fromkeys([str(first), *_wrong_alone(file, folder, solver_folder or folder)]))
        if len(problems) == 1:
            raise
        raise StudyErrors(file.name, problems) from None


def _wrong_alone(file: StudyFile, folder: Path, solver_folder: Path) -> list[str]:
    """Collect the problems of all parts; every part is built with as few other parts as possible."""
    records = {
        "record": file.record,
        **{
            f"observation.{i}.record": o.record for i, o in enumerate(file.observation, start=1) if o.record is not None
        },
        **{f"prediction.records.{i}": r for i, r in enumerate(file.prediction.records, start=1)},
        **{
            f"{table.word}.records.{i}": r
            for table in stage_tables(file)
            for i, r in enumerate(table.records_to_read, start=1)
        },
    }
    channels = tuple(dict.fromkeys(c for o in file.observation for c in o.channels))
    measured = [index for index, section in enumerate(file.observation) if section.file is not None]
    loop = _loop_or_none(file, folder)
    parts: list[Callable[[], object]] = [
        partial(build_loop, file.loop, folder),
        *(partial(load_record, section, folder, where) for where, section in records.items()),
        *(
            partial(parameter_prior, file, name, loop)
            for name in file.parameters
            if loop is not None or file.loop is None
        ),
        *([partial(build_discrepancy, file, {c: standard_unit(c).si for c in channels})] if channels else []),
        partial(build_sampler, file.sampler),
        partial(build_plan, file.calibration),
        partial(check_tables, file),
        partial(_check_stage_tables, file),
        lambda: (
            check_open_law(file)
            if law_is_open(file)
            else build_model(
                file.model, _some_space(file, loop), file.derived, channels or ("velocity",), solver_folder
            )
        ),
        *(partial(FileContent, folder / str(file.observation[index].file)) for index in measured),
        *(partial(_observed, file, folder, index) for index in measured),
    ]
    problems = []
    for part in parts:
        try:
            part()
        except InputError as error:
            problems.append(str(error))
    return problems


def _loop_or_none(file: StudyFile, folder: Path) -> LoopLines | None:
    """Lines fitted to a measured loop; None if no loop can be read."""
    try:
        return build_loop(file.loop, folder)
    except InputError:
        return None


def _some_space(file: StudyFile, loop: LoopLines | None) -> ParameterSpace:
    """The parameter space; if the priors are invalid, a substitute with the same parameter names."""
    try:
        return parameter_space(file, loop)
    except InputError:
        return ParameterSpace(dict.fromkeys(file.parameters, Gamma(mean=1.0, sd=0.5)))


def _observed(
    file: StudyFile, folder: Path, place: int, record: GroundMotion | None = None
) -> tuple[Observation, Model | None]:
    """Build an observation with its own record, or with the record of the study."""
    section = file.observation[place]
    where = "observation" if len(file.observation) == 1 else f"observation.{place + 1}"
    if section.record is not None:
        record = load_record(section.record, folder, f"{where}.record")
    elif record is None:
        record = load_record(file.record, folder, "record")
    return build_observation(section, record, folder, where, file.seed, place)


def _built(file: StudyFile, folder: Path, solver_folder: Path | None) -> BuiltStudy:
    _check_stage_tables(file)
    raw = read_record(file.record, folder, "record")
    record = processed(raw, file.record, "record")
    if file.record.trim is not None:
        raw = raw.trim(*file.record.trim)  # same time range as the processed record, for a common figure
    loop = build_loop(file.loop, folder)
    predicted = file.campaign.channels if file.campaign is not None else ()
    channels = tuple(dict.fromkeys((*(c for o in file.observation for c in o.channels), *predicted)))
    if not channels:
        channels = next((t.channels_to_record for t in stage_tables(file) if t.channels_to_record), ("velocity",))
    observations, truths = [], []
    for index in range(len(file.observation)):
        observation, truth = _observed(file, folder, index, record)
        observations.append(observation)
        truths.append(truth)
    space, motion_test = parameter_space(file, loop), None
    laws: tuple[HystereticLaw, ...] = ()
    if law_is_open(file):
        motion_test = motion_test_of(file, space, observations)
        laws = tuple(laws_to_compare(file))
        space, model = with_stand_in(motion_test, channels)
    else:
        model = build_model(file.model, space, file.derived, channels, solver_folder or folder)
    posterior = None
    if observations:
        measured = {c: unit for o in observations for c, unit in zip(o.channels, o.error_units, strict=True)}
        error_model = build_discrepancy(file, measured)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", StructidWarning)  # `plausibility` reports the warnings of priors
            posterior = Posterior(space, model, observations, error_model, model_error=file.surrogate.model_error)
    others = tuple(
        load_record(r, folder, f"prediction.records.{i}") for i, r in enumerate(file.prediction.records, start=1)
    )
    driven_by = {r.content_hash: r for r in (record, *(o.record for o in observations)) if isinstance(r, GroundMotion)}
    with within("key 'prediction.channels'"):  # report an error here, not after the sampling
        model.recording(*(file.prediction.channels or model.channels))
    design, campaign_records = build_campaign(file, folder, space, tuple(driven_by.values()))
    sampler, plan = build_sampler(file.sampler), build_plan(file.calibration)
    if plan is not None and posterior is not None and file.surrogate.kind != "none":
        plan = plan.sized(posterior, surrogate_settings(file.surrogate))
    study = BuiltStudy(
        file,
        folder,
        raw,
        record,
        space,
        model,
        design,
        campaign_records,
        posterior,
        sampler,
        tuple(truths),
        others,
        plan,
        loop,
        motion_test,
        laws,
    )
    study = replace(study, planned_stages=_planned_stages(study))
    _check_something_to_run(study)
    check_before_anything_is_written(study)
    return study


def _planned_stages(study: BuiltStudy) -> ByType:
    """Collect the settings of every stage that has a table in the file."""
    stages = ByType()
    for table in stage_tables(study.file):
        planned = table.planned(study)
        stages = stages.having(type(planned), planned)
    return stages


def _check_stage_tables(file: StudyFile) -> None:
    """Reject a stage that needs posterior draws in a study without a measurement."""
    for table in stage_tables(file):
        if table.needs_draws and not file.observation:
            raise InputError(
                f"table '{table.word}'", "no [observation]", "a measurement, since this stage needs posterior draws"
            )


def _check_something_to_run(study: BuiltStudy) -> None:
    if study.posterior is not None or study.campaign is not None or stands_alone(study.file):
        return
    alone = [table.word for table in stage_list.tables() if not table.needs_draws]
    *most, last = (f"a [{word}]" for word in ("campaign", *alone))
    raise InputError(
        "the file",
        f"neither an [observation] nor {', '.join(most)} nor {last}",
        "at least one of these tables",
        "Add the table for the measurement or for the model runs.",
    )
