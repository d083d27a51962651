"""Build a programme of hybrid tests from a programme file."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from jaxtyping import Float

from structid.core.errors import InputError, suggestion, within
from structid.core.units import to_si
from structid.ground_motion.record import GroundMotion
from structid.hybrid.control.compensation import AdaptiveTimeSeries, Compensation, PolynomialExtrapolation
from structid.hybrid.control.transfer_system import Actuator, Sensor
from structid.hybrid.coupling.base import Coupling
from structid.hybrid.coupling.gravouil_combescure import GravouilCombescure
from structid.hybrid.coupling.prakash_hjelmstad import PrakashHjelmstad
from structid.hybrid.experiment import HybridTest
from structid.hybrid.laboratory.openfresco import OpenFrescoSpecimen
from structid.hybrid.laboratory.remote import RemoteSpecimen
from structid.hybrid.laboratory.simulated_specimen import SimulatedSpecimen
from structid.hybrid.laboratory.specimen import Specimen
from structid.hybrid.online.unscented_filter import UnscentedFilter
from structid.hybrid.programme import Programme
from structid.hybrid.substructures.substructure import Substructure
from structid.models import model_list
from structid.models.traceable import TraceableModel, as_traceable
from structid.study.building.models import build_model
from structid.study.building.named_kind import kind_named
from structid.study.building.priors import parameter_space
from structid.study.building.records import load_record
from structid.study.programmes.programme_file import (
    CompensationTable,
    CouplingTable,
    ProgrammeFile,
    SensorTable,
    TestTable,
)
from structid.study.programmes.two_storeys import CutStructure, cut_structure, force_of, moved_channels, moved_model
from structid.study.schema.static_tables import ModelTable

OPENFRESCO = "openfresco://"


@dataclass(frozen=True, eq=False)
class PlannedProgramme:
    """A programme of hybrid tests that is ready to run."""

    file: ProgrammeFile  # content of the file
    folder: Path  # base of relative paths
    record: GroundMotion  # record before scaling
    structure: CutStructure  # structure divided into two parts

    def specimen(self) -> SimulatedSpecimen:
        """Build a new simulated specimen."""
        given, structure = self.file.specimen, self.structure
        model = moved_model(given.model, self.folder)
        actuators = [self._actuator(unit) for unit in structure.units]
        with within("table 'specimen'"):
            return SimulatedSpecimen(
                force_of(model, len(structure.units)),
                actuators,
                channels=structure.channels,
                units=structure.units,
                stiffness=self.parts(1)[1].stiffness,
                controller_step=given.controller_step,
                seed=self.file.seed,
                name=f"{self.file.name}, {model.kind_in_words}",
                real_time=given.real_time,
            )

    def laboratory(self, address: str, secret: str | Callable[[], str]) -> Specimen:
        """Connect to a remote specimen."""
        if address.startswith(OPENFRESCO):
            description = self.specimen().describe().model_copy(update={"simulated": False, "software": "OpenFresco"})
            return OpenFrescoSpecimen(address.removeprefix(OPENFRESCO), description)
        return RemoteSpecimen(address, secret if isinstance(secret, str) else secret())

    def _actuator(self, unit: str) -> Actuator:
        """Build an actuator; for a rotation channel, stroke, speed, noise and range refer to a lever arm of 1 m."""
        given = self.file.specimen.actuator
        settings = {name: getattr(given, name) for name in ("delay", "lag", "stroke", "velocity", "force")}
        with within("table 'specimen.actuator'"):
            return Actuator(
                **settings,
                displacement_sensor=_sensor(given.displacement_sensor, "m", "specimen.actuator.displacement_sensor"),
                force_sensor=_sensor(given.force_sensor, "N", "specimen.actuator.force_sensor"),
            )

    def test(self, section: TestTable, specimen: Specimen) -> HybridTest:
        """Build a test."""
        numerical, physical = self.parts(section.modes)
        with within(f"test '{section.name}'"):
            return HybridTest(
                numerical,
                specimen,
                self.record_of(section),
                dt=self.file.dt,
                time_scale=section.time_scale,
                physical=physical,
                coupling=self.coupling,
                compensation=_compensation(self.file.compensation),
                duration=section.duration,
            )

    def record_of(self, section: TestTable) -> GroundMotion:
        """Scale the record for a test."""
        return replace(self.record.scale_to_pga(section.pga), name=f"{self.record.name}, {section.pga:g} m/s²")

    def parts(self, modes: int) -> tuple[Substructure, Substructure]:
        """Divide the structure; tests with the same number of modes share the parts and their compiled code."""
        if modes not in self._parts:
            self._parts[modes] = self.structure.parts(modes)
        return self._parts[modes]

    @cached_property
    def _parts(self) -> dict[int, tuple[Substructure, Substructure]]:
        return {}

    @cached_property
    def coupling(self) -> Coupling:
        """Coupling method of all tests."""
        return _coupling(self.file.coupling)

    def programme(self, specimen: Specimen | None = None) -> Programme:
        """Build all tests."""
        specimen_of_tests = self.specimen() if specimen is None else specimen
        tests = {section.name: self.test(section, specimen_of_tests) for section in self.file.test}
        online = self.online()
        return Programme({name: replace(test, online=online) for name, test in tests.items()})

    def online(self) -> UnscentedFilter | None:
        """Build the filter that estimates the specimen's parameters during all tests."""
        section = self.file.online
        if section is None:
            return None
        alike = self.structure.alike
        with within("table 'online'"):
            return UnscentedFilter(
                self.learnable(), parameter_space(self.file), section.force_noise, drift=section.drift, updates=alike
            )

    def learnable(self) -> TraceableModel:
        """Build the model whose parameters are estimated."""
        file = self.file
        if file.model is None or not file.parameters:
            raise InputError("the file", "no [model] or no [parameters]", "a model of the specimen, with priors")
        space, channels = parameter_space(file), moved_channels(file.model)
        model = as_traceable(build_model(file.model, space, file.derived, channels, self.folder), "table 'model'")
        force = model.static_force(np.ones((1, len(model.free))))
        if force is None or force.dofs != len(self.structure.units):
            allowed = f"a model on which {len(self.structure.units)} displacements can be imposed"
            raise InputError("table 'model'", f"a {model.kind_in_words}", allowed)
        return model

    def known_sd(self) -> Float[np.ndarray, " channel"] | None:
        """Standard deviations of the measured forces; None if not given."""
        given = None if self.file.learning is None else self.file.learning.sd
        if given is None:
            return None
        units = ["N*m" if unit == "rad" else "N" for unit in self.structure.units]
        if len(given) != len(units):
            allowed = f"one number for each of {', '.join(self.structure.channels)}"
            raise InputError("key 'learning.sd'", f"{len(given)} numbers", allowed)
        return np.array([to_si(sd, unit, "key 'learning.sd'") for sd, unit in zip(given, units, strict=True)])

    def section_of(self, name: str) -> TestTable:
        """Find a test by name."""
        return next(section for section in self.file.test if section.name == name)


def planned(file: ProgrammeFile, folder: Path) -> PlannedProgramme:
    """Build a programme, and check its references between tables."""
    names = [section.name for section in file.test]
    if len(set(names)) < len(names):
        raise InputError("key 'test'", f"the names {', '.join(names)}", "different names")
    if file.learning is not None:
        if file.model is None or not file.parameters:
            raise InputError(
                "table 'learning'", "no [model] or no [parameters]", "a model of the specimen, with priors"
            )
        for key in ("from_test", "predict"):
            name = getattr(file.learning, key)
            if name is not None and name not in names:
                raise InputError(f"key 'learning.{key}'", f"'{name}'", ", ".join(names), suggestion(name, names))
        if file.learning.predict is not None and names.index(file.learning.predict) <= names.index(
            file.learning.from_test
        ):
            raise InputError(
                "key 'learning.predict'", f"'{file.learning.predict}'", f"a test after {file.learning.from_test}"
            )
    record = load_record(file.record, folder, "record")
    alike = file.online is not None and file.online.update
    return PlannedProgramme(file, folder, record, cut_structure(file.structure, _expected(file), folder, alike))


def _expected(file: ProgrammeFile) -> ModelTable:
    """Expected specimen for virtual runs: the calibrated model at its prior medians."""
    if file.model is None:
        return file.specimen.model
    space = parameter_space(file)
    medians = space.quantile(np.full((1, len(space.names)), 0.5))[0]
    keys = kind_named(file.model.type, model_list.MODELS).keys
    named = {name: float(value) for name, value in zip(space.names, medians, strict=True) if name in keys}
    return file.model.model_copy(update=named)


def _sensor(section: SensorTable, unit: str, where: str) -> Sensor:
    noise, limit = (None if v is None else to_si(v, unit, f"key '{where}'") for v in (section.noise, section.range))
    return Sensor(0.0 if noise is None else noise, limit, section.bits)


def _coupling(section: CouplingTable) -> Coupling:
    if section.type == "gravouil_combescure":
        if section.alpha:
            raise InputError("key 'coupling.alpha'", f"{section.alpha:g}", "no such key: this coupling has α = 0")
        return GravouilCombescure(section.substeps, section.fine)
    return PrakashHjelmstad(section.substeps, section.fine, alpha=section.alpha or 0.0)


def _compensation(section: CompensationTable | None) -> Compensation | None:
    if section is None:
        return None
    if section.type == "adaptive_time_series":
        if section.order is not None:
            raise InputError("key 'compensation.order'", f"{section.order}", "no such key: only polynomial has it")
        return AdaptiveTimeSeries(section.delay)
    return PolynomialExtrapolation(section.delay, 3 if section.order is None else section.order)
