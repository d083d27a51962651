"""The file of a programme of hybrid tests: its tables, and functions to read and check it."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Annotated, Any, Literal

import pydantic
from pydantic import Field, create_model

from structid.core.keys import FileTable, Fraction, MetresPerSecond, MetresPerSecondSquared, Seconds, quantity
from structid.inference.error_models import error_model_list
from structid.inference.error_models.error_model_kind import ErrorModelKind
from structid.inference.sampling import sampler_list
from structid.inference.sampling.sampler_list import SamplerKind
from structid.models import model_list
from structid.models.masonry import wall_kind
from structid.models.model_kind import ModelKind
from structid.study.schema.kinds import (
    SurrogateTable,
    discrepancy_table,
    model_table,
    sampler_table,
    surrogate_table,
)
from structid.study.schema.problems import StudyErrors, problem
from structid.study.schema.static_tables import LARGEST_COUNT, CalibrationTable, ModelTable, PriorTable
from structid.study.schema.study_file import CalibrationFile, study_content
from structid.surrogates import surrogate_list as surrogates
from structid.surrogates.surrogate_kind import SurrogateKind

Kilograms: Any = quantity("kg")
Metres: Any = quantity("m")
Newtons: Any = quantity("N")
NewtonsPerMetre: Any = quantity("N/m")


class ShearFrameTable(FileTable):
    """A shear frame whose lowest storey is the specimen; the storeys above it stay linear."""

    type: Literal["shear_frame"]
    storeys: int = Field(ge=2, le=100)
    mass: Kilograms
    stiffness: Annotated[NewtonsPerMetre, Field(gt=0)]
    largest_stiffness: Annotated[NewtonsPerMetre, Field(gt=0)] | None = None
    damping_ratio: Fraction = 0.03
    share: Annotated[Fraction, Field(gt=0, lt=1)] = 0.5


class FacadeTable(FileTable):
    """A masonry wall of two storeys; the lower storey is the specimen, the upper storey stays linear."""

    type: Literal["facade"]
    wall: ModelTable
    floor_mass: Kilograms = 6000.0
    roof_mass: Kilograms = 6000.0
    stiffness_margin: Annotated[float, Field(ge=1)] = 1.2


class SensorTable(FileTable):
    """Noise and quantisation of a sensor; see `Sensor`."""

    noise: float | str = 0.0
    range: float | str | None = None
    bits: int = Field(default=16, ge=1, le=32)


class ActuatorTable(FileTable):
    """The actuator of every channel of a simulated specimen; see `Actuator`."""

    delay: Seconds = 0.0
    lag: Seconds = 0.0
    stroke: Metres | None = None
    velocity: MetresPerSecond | None = None
    force: Newtons | None = None
    displacement_sensor: SensorTable = SensorTable()
    force_sensor: SensorTable = SensorTable()


class SpecimenTable(FileTable):
    """A simulated specimen: its true behaviour, and its actuators."""

    model: ModelTable
    actuator: ActuatorTable = ActuatorTable()
    controller_step: Seconds = 1e-3
    real_time: bool = False


class CouplingTable(FileTable):
    """The coupling of the two parts; see `PrakashHjelmstad` and `GravouilCombescure`."""

    type: Literal["prakash_hjelmstad", "gravouil_combescure"] = "prakash_hjelmstad"
    substeps: int = Field(default=10, ge=1, le=10_000)
    fine: Literal["numerical", "physical"] = "numerical"
    alpha: float | None = None


class CompensationTable(FileTable):
    """Delay compensation; see `PolynomialExtrapolation` and `AdaptiveTimeSeries`."""

    type: Literal["polynomial", "adaptive_time_series"]
    delay: Seconds
    order: int | None = None


class TestTable(FileTable):
    """One test of the programme."""

    __test__ = False

    name: str
    pga: MetresPerSecondSquared
    time_scale: Annotated[float, Field(gt=0)]
    modes: int = Field(default=1, ge=0)
    duration: Seconds | None = None


class OnlineTable(FileTable):
    """A filter that estimates the parameters of [model] during the tests; see `UnscentedFilter`."""

    force_noise: Newtons
    drift: float = Field(default=0.0, ge=0)
    update: bool = False


class LearningTable(FileTable):
    """Settings for learning from one test and all tests before it, and for predicting a later test."""

    from_test: str
    predict: str | None = None
    draws: int = Field(default=400, ge=50, le=LARGEST_COUNT)
    pieces: int = Field(default=2, ge=1, le=1000)
    sd: tuple[float | str, ...] | None = None


class ProgrammeFile(CalibrationFile):
    """A programme of hybrid tests on one specimen."""

    structure: ShearFrameTable | FacadeTable
    specimen: SpecimenTable
    dt: Annotated[Seconds, Field(gt=0)]
    coupling: CouplingTable = CouplingTable()
    compensation: CompensationTable | None = None
    test: Annotated[tuple[TestTable, ...], Field(min_length=1)]
    online: OnlineTable | None = None
    learning: LearningTable | None = None
    surrogate: SurrogateTable
    calibration: CalibrationTable | None = None
    model: ModelTable | None = None  # type: ignore[assignment]
    parameters: dict[str, PriorTable] = Field(default_factory=dict)


def programme_file() -> type[ProgrammeFile]:
    """Type of a programme file, with the currently registered kinds."""
    return _programme_file(
        model_list.MODELS, tuple(error_model_list.ERROR_MODELS), tuple(sampler_list.SAMPLERS), tuple(surrogates.KINDS)
    )


@functools.cache
def _programme_file(
    model_kinds: tuple[ModelKind, ...],
    error_model_kinds: tuple[ErrorModelKind, ...],
    sampler_kinds: tuple[SamplerKind, ...],
    surrogate_kinds: tuple[SurrogateKind, ...],
) -> type[ProgrammeFile]:
    model: Any = model_table(kind for kind in model_kinds if kind.moved_channel)
    discrepancy: Any = discrepancy_table(error_model_kinds)
    sampler: Any = sampler_table(sampler_kinds)
    surrogate: Any = surrogate_table(surrogate_kinds)
    specimen: Any = create_model("specimen_table", __base__=SpecimenTable, model=(model, ...))
    wall: Any = model_table([wall_kind.KIND])
    facade: Any = create_model("facade_table", __base__=FacadeTable, wall=(wall, ...))
    structure: Any = Annotated[ShearFrameTable | facade, Field(discriminator="type")]
    result: type[ProgrammeFile] = create_model(
        "ProgrammeFile",
        __base__=ProgrammeFile,
        structure=(structure, ...),
        specimen=(specimen, ...),
        model=(model | None, None),
        discrepancy=(discrepancy, discrepancy(kind="ar1")),
        sampler=(sampler, sampler(kind="smc")),
        surrogate=(surrogate, surrogate(kind="none")),
    )
    return result


def is_programme(content: dict[str, Any]) -> bool:
    """Whether a file describes a programme of hybrid tests."""
    return "test" in content or ("specimen" in content and "structure" in content)


def read_programme(path: str | Path) -> ProgrammeFile:
    """Read a programme file and check every key."""
    return parse_programme(study_content(path), str(path))


def parse_programme(content: dict[str, Any], path: str) -> ProgrammeFile:
    """Check the content of a programme file."""
    try:
        return programme_file().model_validate(content)
    except pydantic.ValidationError as errors:
        problems = dict.fromkeys(problem(error, content, programme_file()) for error in errors.errors())
        raise StudyErrors(path, list(problems)) from None
