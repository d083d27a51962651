"""What a study file may say: every key, its unit, its default. Unknown keys are errors with the nearest known one."""

from __future__ import annotations

import difflib
import re
import tomllib
from pathlib import Path
from typing import Annotated, Any, Literal, Union, get_args, get_origin

import pydantic
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, create_model, model_validator

from structid.errors import InputError, suggestion
from structid.keys import Fraction, Hertz, MetresPerSecond, MetresPerSecondSquared, Seconds, quantity
from structid.models.hysteretic_parameters import PARAMETER_UNITS
from structid.models.shear_frame import STOREY_PARAMETERS
from structid.surrogates.registry import by_word


class Section(BaseModel):
    """A table of the file."""

    model_config = ConfigDict(extra="forbid", frozen=True, protected_namespaces=())


class SyntheticSection(Section):
    """A stochastic record made on the spot; see `GroundMotion.synthetic`."""

    seed: int = Field(ge=0)
    duration: Seconds = 40.0
    dt: Seconds = 0.01
    arias: MetresPerSecond = 1.0
    significant_duration: Seconds = 10.0
    middle: Seconds = 8.0
    frequency: Hertz = 2.0
    frequency_slope: float = -0.02
    bandwidth: float = 0.4


class RecordSection(Section):
    """Where the ground motion comes from, and what is done to it, in this order: baseline, filters, resample, trim, scale."""

    file: str | None = None
    synthetic: SyntheticSection | None = None
    name: str | None = None
    unit: str | None = None
    dt: Seconds | None = None
    column: int | None = None
    baseline: Literal["constant", "linear"] | None = None
    highpass: Hertz | None = None
    lowpass: Hertz | None = None
    filter_order: int | None = Field(default=None, ge=1)
    resample: Seconds | None = None
    trim: tuple[Seconds, Seconds] | None = None
    pga: MetresPerSecondSquared | None = None
    scale: float | None = None


class PriorSection(Section):
    """A prior distribution; numbers are in `unit`, or texts with their own unit."""

    distribution: Literal["uniform", "normal", "lognormal", "gamma", "beta", "weibull", "gumbel"]
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


_BoucWenParameters = create_model(  # type: ignore[call-overload]
    "_BoucWenParameters", __base__=Section, **{n: (quantity(u) | None, None) for n, u in PARAMETER_UNITS.items()}
)


def _plain_shapes(table: Any) -> Any:
    """Refuse β and γ with a unit where n is not 1: they are in m⁻ⁿ then, which a length unit would scale wrongly."""
    if isinstance(table, dict) and table.get("exponent", 1) not in (1, 1.0):
        for name in ("beta", "gamma"):
            if isinstance(table.get(name), str):
                raise InputError(
                    name, f"{name} = '{table[name]}' with an exponent that is not 1", "a plain number in m^-n"
                )
    return table


class BoucWenSection(_BoucWenParameters):  # type: ignore[valid-type, misc]
    """The oscillator: parameters that are known, by the names of `BoucWen`; the rest have priors."""

    type: Literal["bouc_wen"]
    substeps: int | None = None

    _shapes = model_validator(mode="before")(_plain_shapes)


def _per_storey(unit: str) -> Any:
    one: Any = quantity(unit)
    several: Any = tuple.__class_getitem__((one, ...))
    return one | several | None


_FrameParameters = create_model(  # type: ignore[call-overload]
    "_FrameParameters", __base__=Section, **{n: (_per_storey(PARAMETER_UNITS[n]), None) for n in STOREY_PARAMETERS}
)


class ShearFrameSection(_FrameParameters):  # type: ignore[valid-type, misc]
    """The frame: parameters that are known, by the names of `ShearFrame`; the rest have priors."""

    type: Literal["shear_frame"]
    storeys: int
    damping_ratio: Fraction | None = None
    damping: Literal["modal", "rayleigh"] = "modal"
    rayleigh_mode: int = 3
    substeps: int | None = None

    _shapes = model_validator(mode="before")(_plain_shapes)


class ExternalSection(Section):
    """What the models of other people's solvers share."""

    channels: tuple[str, ...]
    parameters: tuple[str, ...] | None = None
    time_limit: Annotated[Seconds, Field(gt=0)] | None = None
    version: str = ""


class PythonSection(ExternalSection):
    """A Python function in a file beside the study; see `CallableModel`."""

    type: Literal["python"]
    source: str
    function: str = "respond"


class OutputSection(Section):
    """Where a program leaves its histories; see `OutputFile`."""

    path: str
    columns: dict[str, int | str] = Field(min_length=1)
    units: dict[str, str] = {}
    time: int | str | None = None


class ProgramSection(ExternalSection):
    """A program; see `ProgramModel`."""

    type: Literal["program"]
    channels: tuple[str, ...] = ()
    command: str
    output: OutputSection
    templates: dict[str, str] = {}
    record_file: str | None = None
    constants: dict[str, float | str] = {}
    copies: tuple[str, ...] = ()
    keep: Literal["failed", "all", "none"] = "failed"
    environment: dict[str, str] = {}


class UMBridgeSection(ExternalSection):
    """A model served over HTTP; see `UMBridgeModel`."""

    type: Literal["umbridge"]
    url: str
    model: str = "forward"
    config: dict[str, Any] = {}
    send_record: bool = False


BuiltInSection = Annotated[Union[BoucWenSection, ShearFrameSection], Field(discriminator="type")]  # noqa: UP007
ModelSection = Annotated[
    Union[BoucWenSection, ShearFrameSection, PythonSection, ProgramSection, UMBridgeSection],  # noqa: UP007
    Field(discriminator="type"),
]


class VirtualSection(Section):
    """A virtual experiment: the true model's parameters, and the noise as a fraction of each channel's RMS."""

    noise: Annotated[Fraction, Field(ge=0)] = 0.0
    seed: int | None = Field(default=None, ge=0)
    model: BuiltInSection


class ObservationSection(Section):
    """A measured history, or a virtual one; with its own record if it is not the study's."""

    channels: tuple[str, ...] = ("velocity",)
    file: str | None = None
    unit: str | None = None
    column: int | None = None
    dt: Seconds | None = None
    virtual: VirtualSection | None = None
    record: RecordSection | None = None
    gain: PriorSection | None = None
    offset: PriorSection | None = None
    time_shift: PriorSection | None = None


class DiscrepancySection(Section):
    """The law of the difference between model and measurement."""

    kind: Literal["iid", "ar1", "matern32", "damped_cosine"] = "iid"
    variance: float | str | PriorSection | None = None
    per_channel: bool = True
    white: float | str | PriorSection | None = None
    correlation_time: float | str | PriorSection | None = None
    frequency: float | str | PriorSection | None = None
    damping: float | str | PriorSection | None = None


class SamplerSection(Section):
    """The sampler; see `AIES`, `SMC`, `NUTS`, `DelayedAcceptance`. What is left out converges on the benchmark study."""

    kind: Literal["aies", "smc", "nuts", "delayed_acceptance"] = "aies"
    walkers: int | None = None
    particles: int | None = None
    steps: int | None = None
    ensembles: int | None = None
    stretch: float | None = None
    independent: float | None = None
    differential_evolution: float | None = None
    discard: float | None = None
    start_candidates: int | None = None
    settling_steps: int | None = None
    effective_share: float | None = None
    correlation: float | None = None
    chains: int | None = None
    warm_up: int | None = None
    target_acceptance: float | None = None
    tuning: int | None = None
    sub_steps: int | None = None
    most_sub_steps: int | None = None


class DeterministicSection(Section):
    """Deterministic calibration beside the Bayesian one; an empty list of methods leaves it out."""

    methods: tuple[Literal["pattern_search", "interior_point"], ...] | None = None
    starts: int = Field(default=10, ge=1)
    constraints: tuple[str, ...] = ()
    bounds: dict[str, tuple[float | str, float | str]] = {}


class CampaignSection(Section):
    """A design of true runs, stored; see `Campaign`."""

    runs: int = Field(ge=1)
    method: Literal["latin_hypercube", "maximin", "sobol", "random"] = "sobol"
    widen: float | None = Field(default=None, gt=0)
    seed: int | None = Field(default=None, ge=0)
    channels: tuple[str, ...] = ()
    attempts: int = Field(default=1, ge=1)
    records: tuple[RecordSection, ...] = ()


class CalibrationSection(Section):
    """True runs where the posterior is, until a certificate holds; see `calibrate`."""

    true_runs: int = 500
    start: int = Field(default=60, ge=10)
    batch: int = Field(default=40, ge=5)
    certificate: int = Field(default=200, ge=50)


class SurrogateSection(Section):
    """Keys of a surrogate of any kind."""

    kind: str
    validation: int = Field(default=500, ge=10)
    limit: float | None = Field(default=None, gt=0)
    outside: Literal["warn", "refuse", "allow"] | None = None
    trust: bool = False
    model_error: bool = False


_AnySurrogate: Any = create_model(  # type: ignore[call-overload]
    "SurrogateSection",
    __base__=SurrogateSection,
    kind=(Literal[tuple(["none", *by_word()])], ...),
    **{key: (kind | None, None) for each in by_word().values() for key, kind in each.keys.items()},
)


class PredictionSection(Section):
    """Prediction for other records."""

    records: tuple[RecordSection, ...] = ()
    draws: int = Field(default=400, ge=2)


class StudyFile(Section):
    """A whole study."""

    name: str
    title: str = ""
    seed: int = Field(default=1, ge=0)
    record: RecordSection
    model: ModelSection
    parameters: dict[str, PriorSection] = Field(min_length=1)
    derived: dict[str, str] = {}
    correlation: dict[str, float] = {}
    observation: Annotated[
        tuple[ObservationSection, ...], BeforeValidator(lambda v: (v,) if isinstance(v, dict) else v)
    ] = ()
    campaign: CampaignSection | None = None
    surrogate: Annotated[SurrogateSection, BeforeValidator(_AnySurrogate.model_validate)] = SurrogateSection(
        kind="none"
    )
    calibration: CalibrationSection | None = None
    discrepancy: DiscrepancySection = DiscrepancySection()
    sampler: SamplerSection = SamplerSection()
    deterministic: DeterministicSection = DeterministicSection()
    prediction: PredictionSection = PredictionSection()


class StudyErrors(InputError):
    """Everything that is wrong with a study file.

    Parameters
    ----------
    path : str
        The file.
    problems : list of str
        One paragraph for each.
    """

    def __init__(self, path: str, problems: list[str]) -> None:
        self.path, self.problems = path, problems
        Exception.__init__(self, "\n".join(f"{path}: {p}" for p in problems))

    def __reduce__(self) -> Any:
        return (StudyErrors, (self.path, self.problems))


def read_study(path: str | Path) -> StudyFile:
    """Read a study file and check every key.

    Parameters
    ----------
    path : path-like
        A TOML file.

    Returns
    -------
    StudyFile
        Its content, quantities in SI.

    Raises
    ------
    InputError
        If there is no such file, or it is no TOML; `StudyErrors` with everything wrong if keys or values are.
    """
    file = Path(path)
    if not file.is_file():
        raise InputError(f"{path}", "there is no such file", "a study file", "Make one with: structid new NAME.")
    try:
        content = tomllib.loads(file.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as cause:
        raise InputError(
            f"{path}", f"it is no TOML: {cause}", "a TOML file", 'A text value needs quotes: mass = "12 t".'
        ) from None
    return parse_study(content, str(path))


def parse_study(content: dict[str, Any], path: str = "study") -> StudyFile:
    """Check the content of a study file.

    Parameters
    ----------
    content : dict
        As TOML gives it.
    path : str
        Its name, for messages.

    Returns
    -------
    StudyFile
        The study.

    Raises
    ------
    StudyErrors
        With everything that is wrong.
    """
    try:
        return StudyFile.model_validate(content)
    except pydantic.ValidationError as errors:
        problems = dict.fromkeys(_problem(error, content) for error in errors.errors())
        raise StudyErrors(path, list(problems)) from None


_VARIANTS = {"bouc_wen", "shear_frame", "python", "program", "umbridge", "float", "str", "PriorSection", "int"}
"""Steps of pydantic's locations that name a variant of a type, not a key."""


def _problem(error: Any, content: dict[str, Any]) -> str:
    """One paragraph: key, what came, what is allowed, what to do."""
    steps = [s for s in error["loc"] if not (isinstance(s, str) and (s in _VARIANTS or "[" in s or "tuple" in s))]
    if steps[:1] == ["observation"] and isinstance(content.get("observation"), dict):
        steps = [s for s in steps if s != 0]  # a single table stands for a list of one
    key = ".".join(str(s) for s in steps) or "the file"
    cause = error.get("ctx", {}).get("error")
    if isinstance(cause, InputError):
        what = f"{cause.where}: " if cause.where.startswith("unit ") else ""
        return f"key '{key}': {what}{cause.came}. Allowed: {cause.allowed}.{' ' + cause.cure if cause.cure else ''}"
    match error["type"]:
        case "extra_forbidden":
            known = _known_keys(steps[:-1], content)
            near = difflib.get_close_matches(str(steps[-1]), known, n=1, cutoff=0.4)
            hint = f" Did you mean '{near[0]}'?" if near else ""
            return f"key '{key}': an unknown key. Allowed here: {', '.join(known)}.{hint}"
        case "missing":
            return f"key '{key}': it is missing. Add it."
        case "literal_error":
            return f"key '{key}': {error['input']!r}. Allowed: {error['ctx']['expected']}."
        case "union_tag_invalid":
            tag, expected = error["ctx"]["tag"], error["ctx"]["expected_tags"]
            cure = suggestion(tag, re.findall(r"'(\w+)'", expected))
            return f"key '{key}.type': '{tag}'. Allowed: {expected}. {cure}".rstrip()
        case "union_tag_not_found":
            return f"key '{key}.type': it is missing. Allowed: 'bouc_wen', 'shear_frame', 'python', 'program' or 'umbridge'."
        case _:
            return f"key '{key}': {error['input']!r}. {error['msg']}."


def _known_keys(steps: list[Any], content: dict[str, Any]) -> list[str]:
    """Keys that the table at a place of the file may have."""
    tables: list[Any] = [StudyFile]
    here: Any = content
    for step in steps:
        here = here[step] if isinstance(here, (dict, list)) and (isinstance(step, int) or step in here) else {}
        if isinstance(step, int):
            continue
        found: list[Any] = []
        for table in tables:
            field = table.model_fields.get(step) if isinstance(table, type) and issubclass(table, BaseModel) else None
            found += _tables(field.annotation) if field else [table] if table is PriorSection else []
        tables = found
    kind = here.get("type") if isinstance(here, dict) else None
    if kind is not None:
        typed = [t for t in tables if "type" in t.model_fields]
        tables = [t for t in typed if kind in get_args(t.model_fields["type"].annotation)] or tables
    return sorted({name for table in tables for name in table.model_fields})


def _tables(annotation: Any) -> list[Any]:
    """All sections a field's annotation allows."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    arguments = get_args(annotation) if get_origin(annotation) is not None else ()
    return [table for argument in arguments for table in _tables(argument)]
