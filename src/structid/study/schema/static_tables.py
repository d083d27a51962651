"""Tables of a study file with fixed keys."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from structid.core.keys import FileTable, Fraction, Hertz, MetresPerSecond, MetresPerSecondSquared, Seconds

Stretch = tuple[Seconds, Seconds]
"""Begin and end of a stretch of a record [s]."""

Rest = tuple[float | str, float | str]
"""Begin and end of a stretch of a measurement, which may be negative: numbers in seconds, or text with a unit."""

LARGEST_COUNT = 1_000_000
"""Largest number of runs, points or draws in a file; a larger number is a typing error and would exceed the memory."""


class SyntheticTable(FileTable):
    """A simulated record; see `GroundMotion.synthetic`."""

    seed: int = Field(ge=0)
    duration: Seconds = 40.0
    dt: Seconds = 0.01
    arias: MetresPerSecond = 1.0
    significant_duration: Seconds = 10.0
    middle: Seconds = 8.0
    frequency: Hertz = 2.0
    frequency_slope: float = -0.02
    bandwidth: float = 0.4


class RecordTable(FileTable):
    """Source and processing of a record; order of processing: baseline, filters, resample, trim, scale."""

    file: str | None = None
    synthetic: SyntheticTable | None = None
    name: str | None = None
    unit: str | None = None
    dt: Seconds | None = None
    column: int | str | None = None
    time_column: int | str | None = None
    component: int | str | None = None
    baseline: Literal["constant", "linear"] | Stretch | tuple[Stretch, Stretch] | None = None
    highpass: Hertz | None = None
    lowpass: Hertz | None = None
    filter_order: int | None = Field(default=None, ge=1)
    resample: Seconds | None = None
    trim: tuple[Seconds, Seconds] | None = None
    pga: MetresPerSecondSquared | None = None
    scale: float | None = None


class PriorTable(FileTable):
    """A prior distribution; its values are numbers in `unit`, or strings with their own unit."""

    distribution: Literal["uniform", "normal", "lognormal", "gamma", "beta", "weibull", "gumbel", "loop"]
    unit: str | None = None
    mean: float | str | None = None
    sd: float | str | None = None
    low: float | str | None = None
    high: float | str | None = None
    shape: float | None = None
    rate: float | None = None
    scale: float | str | None = None
    location: float | str | None = None
    log_mean: float | None = None
    log_sd: float | None = None
    a: float | None = None
    b: float | None = None


class LoopColumnsTable(FileTable):
    """A file with columns of displacement and force."""

    file: str
    displacement_unit: str
    force_unit: str
    displacement_column: int | str = 0
    force_column: int | str = 1


class LoopTable(LoopColumnsTable):
    """A measured force-displacement loop from which priors of stiffness and alpha are derived; see `LoopLines`."""

    elastic: Annotated[Fraction, Field(gt=0, lt=1)] = 0.1
    yielded: Annotated[Fraction, Field(gt=0, lt=1)] = 0.75


class ModelTable(FileTable):
    """The model with its known parameters by name; the unknown parameters have priors."""

    type: str


class VirtualTable(FileTable):
    """A virtual experiment: parameters of the true model, and noise as a fraction of each channel's RMS."""

    noise: Annotated[Fraction, Field(ge=0)] = 0.0
    seed: int | None = Field(default=None, ge=0)
    model: ModelTable


class ObservationTable(FileTable):
    """A measured or virtual history, with its own record if it differs from the record of the study."""

    channels: tuple[str, ...] = Field(default=("velocity",), min_length=1)
    file: str | None = None
    unit: str | None = None
    column: int | str | None = None
    time_column: int | str | None = None
    component: int | str | None = None
    dt: Seconds | None = None
    virtual: VirtualTable | None = None
    record: RecordTable | None = None
    baseline: Rest | tuple[Rest, Rest] | None = None
    missing: Literal["refuse", "leave_out"] | None = None
    gaps: tuple[Rest, ...] | None = None
    polarity: Literal["normal", "reversed", "unknown"] = "normal"
    gain: PriorTable | None = None
    offset: PriorTable | None = None
    drift: PriorTable | None = None
    time_shift: float | str | PriorTable | None = None
    sd: float | str | None = None
    sd_column: int | None = None


class DeterministicTable(FileTable):
    """Deterministic calibration for comparison; an empty list of methods disables it."""

    methods: tuple[Literal["pattern_search", "interior_point"], ...] | None = None
    starts: int = Field(default=10, ge=1, le=LARGEST_COUNT)
    constraints: tuple[str, ...] = ()
    bounds: dict[str, tuple[float | str, float | str]] = Field(default_factory=dict)


class CampaignTable(FileTable):
    """A stored design of model runs; see `Campaign`."""

    runs: int = Field(ge=1, le=LARGEST_COUNT)
    method: Literal["latin_hypercube", "maximin", "sobol", "random"] = "sobol"
    widen: float | None = Field(default=None, gt=0)
    seed: int | None = Field(default=None, ge=0)
    channels: tuple[str, ...] = ()
    attempts: int = Field(default=1, ge=1)
    records: tuple[RecordTable, ...] = ()


class CalibrationTable(FileTable):
    """Model runs near the posterior, until the surrogate is certified; see `calibrate`."""

    true_runs: int = Field(default=500, le=LARGEST_COUNT)
    start: int | None = Field(default=None, ge=10, le=LARGEST_COUNT)
    batch: int | None = Field(default=None, ge=4, le=LARGEST_COUNT)
    certificate: int = Field(default=30, ge=20, le=LARGEST_COUNT)


class PredictionTable(FileTable):
    """Prediction for other records."""

    records: tuple[RecordTable, ...] = ()
    channels: tuple[str, ...] = ()
    draws: int = Field(default=400, ge=2, le=LARGEST_COUNT)
