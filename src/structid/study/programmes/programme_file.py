"""The file of a programme of hybrid tests: its tables, and how it is read and checked."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Annotated, Any, Literal

import pydantic
from pydantic import Field, create_model

from structid.core.keys import Fraction, MetresPerSecond, MetresPerSecondSquared, Seconds, Section, quantity
from structid.inference.error_models import error_model_list
from structid.inference.error_models.error_model_kind import ErrorModelKind
from structid.inference.sampling import sampler_list
from structid.inference.sampling.sampler_list import SamplerKind
from structid.models import model_list
from structid.models.masonry import wall_kind
from structid.models.model_kind import ModelKind
from structid.study.schema.kinds import (
    SurrogateSection,
    discrepancy_section,
    model_section,
    sampler_section,
    surrogate_section,
)
from structid.study.schema.problems import StudyErrors, problem
from structid.study.schema.static_tables import LARGEST_COUNT, CalibrationSection, ModelSection, PriorSection
from structid.study.schema.study_file import CalibrationFile, study_content
from structid.surrogates import surrogate_list as surrogates
from structid.surrogates.surrogate_kind import SurrogateKind

Kilograms: Any = quantity("kg")
Metres: Any = quantity("m")
Newtons: Any = quantity("N")
NewtonsPerMetre: Any = quantity("N/m")


class ShearFrameSection(Section):
    """A frame whose lowest storey is the specimen; the storeys above it stay linear."""

    type: Literal["shear_frame"]
    storeys: int = Field(ge=2, le=100)
    mass: Kilograms
    stiffness: Annotated[NewtonsPerMetre, Field(gt=0)]
    largest_stiffness: Annotated[NewtonsPerMetre, Field(gt=0)] | None = None
    damping_ratio: Fraction = 0.03
    share: Annotated[Fraction, Field(gt=0, lt=1)] = 0.5


class FacadeSection(Section):
    """Two storeys of a masonry wall; the lower one is the specimen, the upper one stays linear."""

    type: Literal["facade"]
    wall: ModelSection
    floor_mass: Kilograms = 6000.0
    roof_mass: Kilograms = 6000.0
    stiffness_margin: Annotated[float, Field(ge=1)] = 1.2


class SensorSection(Section):
    """Noise and quantisation of a sensor; see `Sensor`."""

    noise: float | str = 0.0
    range: float | str | None = None
    bits: int = Field(default=16, ge=1, le=32)


class ActuatorSection(Section):
    """An actuator of a simulated specimen, for every channel; see `Actuator`."""

    delay: Seconds = 0.0
    lag: Seconds = 0.0
    stroke: Metres | None = None
    velocity: MetresPerSecond | None = None
    force: Newtons | None = None
    displacement_sensor: SensorSection = SensorSection()
    force_sensor: SensorSection = SensorSection()


class SpecimenSection(Section):
    """A simulated specimen: its true behaviour, and its actuators."""

    model: ModelSection
    actuator: ActuatorSection = ActuatorSection()
    controller_step: Seconds = 1e-3
    real_time: bool = False


class CouplingSection(Section):
    """The coupling of both parts; see `PrakashHjelmstad` and `GravouilCombescure`."""

    type: Literal["prakash_hjelmstad", "gravouil_combescure"] = "prakash_hjelmstad"
    substeps: int = Field(default=10, ge=1, le=10_000)
    fine: Literal["numerical", "physical"] = "numerical"
    alpha: float | None = None


class CompensationSection(Section):
    """Delay compensation; see `PolynomialExtrapolation` and `AdaptiveTimeSeries`."""

    type: Literal["polynomial", "adaptive_time_series"]
    delay: Seconds
    order: int | None = None


class TestSection(Section):
    """One test of the programme."""

    __test__ = False

    name: str
    pga: MetresPerSecondSquared
    time_scale: Annotated[float, Field(gt=0)]
    modes: int = Field(default=1, ge=0)
    duration: Seconds | None = None


class OnlineSection(Section):
    """A filter that tracks the parameters of [model] during the tests; see `UnscentedFilter`."""

    force_noise: Newtons
    drift: float = Field(default=0.0, ge=0)
    update: bool = False


class LearningSection(Section):
    """Learning from one test and those before, and prediction of a later test."""

    from_test: str
    predict: str | None = None
    draws: int = Field(default=400, ge=50, le=LARGEST_COUNT)
    pieces: int = Field(default=2, ge=1, le=1000)
    sd: tuple[float | str, ...] | None = None


class ProgrammeFile(CalibrationFile):
    """A programme of hybrid tests on one specimen."""

    structure: ShearFrameSection | FacadeSection
    specimen: SpecimenSection
    dt: Annotated[Seconds, Field(gt=0)]
    coupling: CouplingSection = CouplingSection()
    compensation: CompensationSection | None = None
    test: Annotated[tuple[TestSection, ...], Field(min_length=1)]
    online: OnlineSection | None = None
    learning: LearningSection | None = None
    surrogate: SurrogateSection
    calibration: CalibrationSection | None = None
    model: ModelSection | None = None  # type: ignore[assignment]
    parameters: dict[str, PriorSection] = Field(default_factory=dict)


def programme_file() -> type[ProgrammeFile]:
    """Type of a programme's file, with the kinds registered now."""
    return _programme_file(
        model_list.MODELS, tuple(error_model_list.ERROR_MODELS), tuple(sampler_list.SAMPLERS), tuple(surrogates.KINDS)
    )


@functools.cache
def _programme_file(
    model_kinds: tuple[ModelKind, ...],
    law_kinds: tuple[ErrorModelKind, ...],
    sampler_kinds: tuple[SamplerKind, ...],
    surrogate_kinds: tuple[SurrogateKind, ...],
) -> type[ProgrammeFile]:
    model: Any = model_section(kind for kind in model_kinds if kind.moved_channel)
    discrepancy: Any = discrepancy_section(law_kinds)
    sampler: Any = sampler_section(sampler_kinds)
    surrogate: Any = surrogate_section(surrogate_kinds)
    specimen: Any = create_model("specimen_section", __base__=SpecimenSection, model=(model, ...))
    wall: Any = model_section([wall_kind.KIND])
    facade: Any = create_model("facade_section", __base__=FacadeSection, wall=(wall, ...))
    structure: Any = Annotated[ShearFrameSection | facade, Field(discriminator="type")]
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
    """Whether a file describes a programme."""
    return "test" in content or ("specimen" in content and "structure" in content)


def read_programme(path: str | Path) -> ProgrammeFile:
    """Read the file of a programme and check every key."""
    content = study_content(path)
    try:
        return programme_file().model_validate(content)
    except pydantic.ValidationError as errors:
        problems = dict.fromkeys(problem(error, content, programme_file()) for error in errors.errors())
        raise StudyErrors(str(path), list(problems)) from None
