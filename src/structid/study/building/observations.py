"""The measurements and the error model of a study."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from structid.core.channels import standard_unit
from structid.core.errors import InputError, within
from structid.core.streams import Purpose, stream
from structid.core.units import factor_of, si_unit, squared, to_si
from structid.ground_motion.record import GroundMotion
from structid.histories import Histories
from structid.inference.error_model_choice import AUTO
from structid.inference.error_models import error_model_list
from structid.inference.error_models.base import ErrorModel
from structid.inference.error_models.error_model_kind import SQUARED
from structid.inference.error_models.independent import IID
from structid.models.base import Model
from structid.observation import NUISANCES, Observation
from structid.study.building.models import true_model
from structid.study.building.named_kind import check_keys, kind_named
from structid.study.building.priors import known_or_prior, prior_of
from structid.study.schema.static_tables import ObservationTable, PriorTable, VirtualTable
from structid.study.schema.study_file import CalibrationFile

KEYS_OF_FILES = ("column", "time_column", "component", "dt", "sd_column", "baseline", "missing", "gaps")
"""Keys of measured files."""


def build_observation(
    section: ObservationTable, record: GroundMotion, folder: Path, where: str, seed: int, index: int
) -> tuple[Observation, Model | None]:
    """Read a measured history, or simulate a virtual one."""
    if (section.file is None) == (section.virtual is None):
        came = "neither file nor virtual" if section.file is None else "both file and virtual"
        raise InputError(f"key '{where}'", came, "exactly one of the two")
    unit = _si_unit(section, f"key '{where}.unit'")
    units_of_nuisances = {"gain": "", "offset": unit, "drift": f"({unit})/s" if unit else "", "time_shift": "s"}
    nuisances: dict[str, Any] = {
        name: prior_of(prior, f"{where}.{name}", units_of_nuisances[name])
        for name in NUISANCES
        if isinstance(prior := getattr(section, name), PriorTable)
    }
    sd = None if section.sd is None else to_si(section.sd, unit, f"key '{where}.sd'")
    if section.virtual is not None:
        truth, values = _virtual_experiment(section.virtual, record, section.channels, folder, seed, index)
        _refuse_keys_of_files(section, where)
        polarity = section.polarity
        values = -values if polarity == "reversed" else values  # as this sensor shows them
        return Observation(record, values, section.channels, name=where, sd=sd, polarity=polarity, **nuisances), truth
    assert section.file is not None
    if len(section.channels) != 1:
        raise InputError(
            f"key '{where}.channels'",
            f"{list(section.channels)} from one file",
            "one channel for each file",
            "Give each channel its own [[observation]].",
        )
    if section.unit is not None:
        factor_of(section.unit, unit, f"key '{where}.unit'")
    if isinstance(section.time_shift, (float, str)):
        nuisances["time_shift"] = to_si(section.time_shift, "s", f"key '{where}.time_shift'")
    if section.sd is not None and section.sd_column is not None:
        raise InputError(f"key '{where}.sd'", "both sd and sd_column", "one of the two")
    path, channel = folder / section.file, section.channels[0]
    columns: dict[str, Any] = {
        **{key: value for key in (*KEYS_OF_FILES, "polarity") if (value := getattr(section, key)) is not None},
        "sd": sd,
    }
    if section.baseline is not None:
        columns["baseline"] = _stretches(section.baseline, f"key '{where}.baseline'")
    columns["gaps"] = [_seconds(gap, f"key '{where}.gaps'") for gap in section.gaps or ()]
    return Observation.read(record, path, section.unit, channel, **columns, **nuisances), None


def _stretches(baseline: Any, where: str) -> Any:
    """One stretch of time [s], or two."""
    if isinstance(baseline[0], tuple):
        return [_seconds(pair, where) for pair in baseline]
    return _seconds(baseline, where)


def _seconds(pair: tuple[float | str, float | str], where: str) -> tuple[float, float]:
    """Two times [s]."""
    begin, end = (to_si(time, "s", where) for time in pair)
    return begin, end


def _refuse_keys_of_files(section: ObservationTable, where: str) -> None:
    """Reject keys that apply only to measured files if the experiment is virtual."""
    for key in KEYS_OF_FILES:
        if getattr(section, key) is not None:
            raise InputError(
                f"key '{where}.{key}'",
                "it is given for a virtual experiment",
                "no such key: it is for measured files only",
            )
    if isinstance(section.time_shift, (int, float, str)):
        raise InputError(f"key '{where}.time_shift'", "a number for a virtual experiment", "a prior, or no such key")


def _virtual_experiment(
    section: VirtualTable,
    record: GroundMotion,
    channels: tuple[str, ...],
    folder: Path,
    seed: int,
    index: int,
) -> tuple[Model, np.ndarray]:
    """Simulate the true model, and add white noise relative to the RMS of each channel."""
    truth = true_model(section.model, channels, folder)
    run: Histories = truth.simulate(np.zeros((1, 0)), record)
    if not run.done[0]:
        raise InputError(
            "key 'observation.virtual'", f"the true model diverges at {run.failure_time[0]:g} s", "a stable model"
        )
    values = run.values[0]
    noise_seed = seed + index if section.seed is None else section.seed
    rng = stream(noise_seed, Purpose.VIRTUAL_NOISE)
    rms = np.sqrt((values**2).mean(axis=0))
    return truth, values + section.noise * rms * rng.standard_normal(values.shape)


def _si_unit(section: ObservationTable, where: str) -> str:
    """SI unit of a measurement, from its channel or from the unit declared for the file."""
    unit_of_channel = standard_unit(section.channels[0]).si
    if unit_of_channel or section.unit is None:
        return unit_of_channel
    with within(where):
        return si_unit(section.unit)


def build_discrepancy(file: CalibrationFile, si_units: Mapping[str, str]) -> ErrorModel:
    """Build the error model."""
    section = file.discrepancy
    if section.kind == AUTO:
        check_keys("discrepancy", AUTO, section.model_fields_set - {"kind"}, ())
        return IID()
    kind = kind_named(section.kind, error_model_list.ERROR_MODELS)
    given = section.model_fields_set - {"kind"}
    check_keys("discrepancy", kind.word, given, kind.keys)
    units = set(si_units.values())
    for key, measures in kind.quantities.items():
        if measures == SQUARED and getattr(section, key) is not None and len(units) > 1:
            raise InputError(
                f"key 'discrepancy.{key}'",
                f"one variance for channels in {', '.join(sorted(units))}",
                "no such key: each channel then has its own unknown variance",
            )
    variance = squared(units.pop())
    values = {
        key: known_or_prior(getattr(section, key), key, variance if measures == SQUARED else measures)
        for key, measures in kind.quantities.items()
        if key in given
    }
    values |= {key: getattr(section, key) for key in kind.switches if key in given}
    with within("table 'discrepancy'"):
        error_model: ErrorModel = kind.error_model(**values)
    return error_model
