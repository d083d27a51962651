"""Oscillator or cyclic specimen with a spring of any hysteretic law."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any, ClassVar, Literal

import numpy as np

from structid.core.channels import check_channels
from structid.core.errors import InputError, fixed_and_free, suggestion
from structid.core.hashing import digest
from structid.core.keys import quantity
from structid.core.units import to_si
from structid.core.validation import check_arguments
from structid.engine.device import jnp
from structid.engine.time_loop import TimeLoop
from structid.ground_motion.excitation import DisplacementHistory, Excitation, check_one_signal
from structid.mechanics.hysteretic_laws.base import HystereticLaw
from structid.mechanics.hysteretic_laws.law_list import LAWS, law_of
from structid.mechanics.law_springs import LawSprings
from structid.models.derived_quantity import DerivedQuantity
from structid.models.hysteretic.hysteretic_parameters import DEFAULT_SUBSTEPS, check_free
from structid.models.hysteretic.law_oscillator import LawOscillator
from structid.models.hysteretic.law_values import (
    MODEL_PARAMETERS,
    PARAMETER_UNITS,
    check_law_priors,
    check_law_value,
)
from structid.models.model_kind import ModelKind, ModelRequest
from structid.models.traceable import TraceableModel, TracedExcitation
from structid.probability.space import ParameterSpace

AUTO = "auto"
"""Value of ``law`` in a study file that leaves the choice among all laws to the data."""

CHANNELS = (
    "displacement",
    "velocity",
    "relative_acceleration",
    "absolute_acceleration",
    "restoring_force",
    "absorbed_energy",
)
"""Channels of the model."""


@check_arguments
@dataclass(frozen=True, eq=False)
class Hysteretic(TraceableModel):
    """A mass on a spring with any hysteretic law, or the spring alone under imposed displacements.

    ::

        m u″ + c u′ + f(u) = −m a_g,    or the force f(u) + F₀ for an imposed displacement u

    The parameters of a law do not depend on the mass. A cyclic test needs no mass; a `GroundMotion` or a `ForceHistory` does.
    The force offset F₀ is part of the measured force of a cyclic test, such as a load cell's zero or a permanent load that
    another force balances. It does not move the mass.

    Parameters
    ----------
    law : str or HystereticLaw
        Name of the law, such as ``"pivot"``; the gallery of laws in the documentation lists all.
    values : mapping of str to float or str
        Values of the law's parameters in SI, or with a unit, such as ``"40 kN"``. Parameters that are neither here nor in `free`
        keep the law's default.
    mass : float, optional
        m [kg].
    damping_ratio, damping : float, optional
        ζ relative to the initial stiffness, or c [N s/m]. Give at most one; the default is no damping.
    force_offset : float
        F₀ [N].
    free : sequence of str
        Parameters that are given with every run, in the order of its columns.
    channels : sequence of str
        Channels to record: displacement, velocity, relative_acceleration, absolute_acceleration, restoring_force, absorbed_energy.
    substeps : int
        Integration steps per sample of a motion. Under imposed displacements, a law without exact moves divides the samples so that
        the default gives a force error below 1 % of the peak.

    Raises
    ------
    InputError
        If the law has no such parameter, a value is missing or impossible, or a name is both free and given.

    Examples
    --------
    >>> import numpy as np
    >>> import structid as si
    >>> wall = si.Hysteretic(law="pivot", values={"stiffness": "20 kN/mm", "yield_force": "40 kN", "pinching": 0.4})
    >>> path = si.DisplacementHistory([0.0, 0.01, -0.01, 0.01], dt=1.0)
    >>> wall.simulate(np.zeros((1, 0)), path).channel("restoring_force")[0] / 1e3
    array([  0.,  40., -40.,  40.])
    """

    steps_setting: ClassVar[str] = "substeps"
    hint_where_not_finite: ClassVar[str] = ""

    law: HystereticLaw | str
    values: Mapping[str, float | str] = field(default_factory=dict)
    mass: float | None = None
    damping_ratio: float | None = None
    damping: float | None = None
    force_offset: float = 0.0
    free: tuple[str, ...] = ()
    channels: tuple[str, ...] = ("restoring_force",)
    substeps: int = DEFAULT_SUBSTEPS

    def __post_init__(self) -> None:
        law = law_of("Hysteretic.law", self.law)
        described = law.parameters()
        free = check_free("Hysteretic", self.free, (*described, *MODEL_PARAMETERS))
        object.__setattr__(self, "free", free)
        object.__setattr__(self, "channels", check_channels("Hysteretic.channels", self.channels, CHANNELS))
        if not (isinstance(self.substeps, (int, np.integer)) and self.substeps >= 1):
            raise InputError("Hysteretic.substeps", f"{self.substeps!r}", "a whole number of 1 or more")
        given = {}
        for name, value in self.values.items():
            if name not in described:
                raise InputError(
                    "Hysteretic.values",
                    f"the law '{law.word}' has no parameter '{name}'",
                    ", ".join(described),
                    suggestion(name, tuple(described)),
                )
            given[name] = to_si(value, described[name].unit, f"Hysteretic.values['{name}']")
        object.__setattr__(self, "law", law.with_values(given))
        object.__setattr__(self, "values", {})
        self._check_values()

    def _check_values(self) -> None:
        """Refuse missing and impossible values, and values of free parameters."""
        assert isinstance(self.law, HystereticLaw)
        for name, described in self.law.parameters().items():
            value = getattr(self.law, name)
            if name in self.free:
                if value is not None and value != described.default:
                    raise fixed_and_free(f"Hysteretic.values['{name}']")
            elif value is None:
                raise InputError(
                    f"Hysteretic.values['{name}']",
                    f"the {described.meaning} has no value and is not free",
                    f"a number{f' in {described.unit}' if described.unit else ''}, or the name in the argument free",
                )
            else:
                check_law_value(f"Hysteretic.values['{name}']", name, value, described)
        for name, described in MODEL_PARAMETERS.items():
            value = getattr(self, name)
            if value is not None and name not in self.free:
                check_law_value(f"Hysteretic.{name}", name, float(value), described)
        if self._given("damping_ratio") and self._given("damping"):
            raise InputError(
                "Hysteretic.damping",
                "both damping_ratio and damping are given",
                "only one of the two",
                "Remove damping.",
            )

    def _given(self, name: str) -> bool:
        return name in self.free or getattr(self, name) is not None

    # --- response -----------------------------------------------------------------------------------------------

    def _values(self, theta: Any) -> tuple[HystereticLaw, dict[str, Any]]:
        """Return the law with arrays over runs for its free parameters, and the other parameters by name."""
        assert isinstance(self.law, HystereticLaw)
        column = {name: theta[:, i] for i, name in enumerate(self.free)}
        law = self.law.with_values({name: column[name] for name in self.free if name not in MODEL_PARAMETERS})
        return law, {name: column.get(name, getattr(self, name)) for name in MODEL_PARAMETERS}

    def steps_in_sample(self, excitation: Excitation) -> int:
        """Count the steps in a sample: as many as a smooth law needs for the moves of a cyclic test; see `TraceableModel`."""
        assert isinstance(self.law, HystereticLaw)
        if excitation.kind != DisplacementHistory.kind:
            return self.substeps
        moves, largest = np.abs(np.diff(excitation.values)), np.abs(excitation.values).max()
        longest = float(moves.max(initial=0.0) / largest) if largest > 0.0 else 0.0
        return max(1, int(np.ceil(longest / self.law.accurate_move * self.substeps / DEFAULT_SUBSTEPS)))

    def time_loop(self, theta: Any, excitation: TracedExcitation) -> TimeLoop:
        """Return the loop over the samples; see `TraceableModel.time_loop`."""
        law, values = self._values(theta)
        like = theta[:, 0] if theta.shape[1] else jnp.zeros(theta.shape[0])
        motion = LawOscillator(law, values, self.channels, excitation.kind, like)
        return motion.time_loop(excitation.stages, excitation.dt, excitation.dropped_samples)

    def static_force(self, theta: Any) -> LawSprings:
        """Return the spring without mass and dashpot; see `TraceableModel.static_force`."""
        law = self._values(theta)[0]
        values = {f.name: getattr(law, f.name) for f in fields(law)}
        return LawSprings(np.ones((1, 1)), law.with_values({n: v[None] for n, v in values.items() if np.ndim(v) == 1}))

    def natural_frequency(self, theta: np.ndarray) -> np.ndarray | None:
        """Return the frequency of the initial stiffness, None without a mass; see `Model.natural_frequency`."""
        law, values = self._values(theta)
        if values["mass"] is None:
            return None
        return np.broadcast_to(np.sqrt(law.stiffness / values["mass"]) / (2.0 * np.pi), len(theta))

    def derived_quantities(self, theta: np.ndarray) -> dict[str, DerivedQuantity]:
        """Return the yield displacement; see `Model.derived_quantities`."""
        law = self._values(theta)[0]
        if "yield_force" not in law.parameters():
            return {}
        displacement = np.broadcast_to(law.yield_force / law.stiffness, len(theta))  # type: ignore[attr-defined]
        return {"yield displacement": DerivedQuantity(displacement, "mm")}

    # --- checks -------------------------------------------------------------------------------------------------

    def check_excitation(self, excitation: Excitation) -> None:
        """Refuse several signals, a motion without a mass, and accelerations under imposed displacements."""
        check_one_signal("Hysteretic", excitation)
        if excitation.kind == DisplacementHistory.kind:
            forbidden = set(self.channels) & {"relative_acceleration", "absolute_acceleration"}
            if forbidden:
                raise InputError(
                    "channels", "acceleration channels with an imposed displacement", "restoring_force, displacement, …"
                )
        elif not self._given("mass"):
            raise InputError(
                "Hysteretic.mass", "no mass", "a mass in kg", f"A {type(excitation).__name__} moves a mass."
            )

    def check_priors(self, space: ParameterSpace) -> None:
        """Refuse priors with a wrong unit or with impossible values; see `Model.check_priors`."""
        assert isinstance(self.law, HystereticLaw)
        check_law_priors(space, self.free, self.law.parameters() | MODEL_PARAMETERS)

    @property
    def content_hash(self) -> str:
        """Hash of all settings."""
        assert isinstance(self.law, HystereticLaw)
        settings = {f.name: getattr(self, f.name) for f in fields(self) if f.name not in ("law", "values")}
        return digest(
            "Hysteretic", self.law.word, {f.name: getattr(self.law, f.name) for f in fields(self.law)}, settings
        )

    # --- description --------------------------------------------------------------------------------------------

    @property
    def loop_channels(self) -> dict[str, tuple[str, str, str]]:
        """Displacement, force and absorbed energy of the spring."""
        return {"": ("displacement", "restoring_force", "absorbed_energy")}

    @property
    def kind_in_words(self) -> str:
        """Descriptive name of the model."""
        assert isinstance(self.law, HystereticLaw)
        return f"{self.law.title}, a mass on it" if self._given("mass") else self.law.title

    def recording(self, *channels: str) -> Hysteretic:
        """Return a copy of this model that records other channels."""
        return replace(self, channels=channels)

    def __str__(self) -> str:
        assert isinstance(self.law, HystereticLaw)
        free = f", free: {', '.join(self.free)}" if self.free else ""
        return f"Hysteretic: {self.law.title}, channels {', '.join(self.channels)}{free}"


NAMED_LAW: Any = Literal[tuple(LAWS)]
"""Name of a law in a study file."""


def _law_of(given: Mapping[str, Any]) -> HystereticLaw:
    """Return the law that a table names."""
    return law_of("key 'model.law'", given["law"])


def _built(asked: ModelRequest) -> Hysteretic:
    given = dict(asked.given)
    law = _law_of(given)
    del given["law"]
    own = (*MODEL_PARAMETERS, "substeps")
    settings = {name: given.pop(name) for name in own if name in given}
    return Hysteretic(law=law, values=given, free=asked.free, channels=asked.channels, **settings)


KIND = ModelKind(
    word="hysteretic",
    keys={
        **{name: (quantity(unit), None) for name, unit in PARAMETER_UNITS.items()},
        "law": (NAMED_LAW | Literal["auto"] | tuple[NAMED_LAW, ...], ...),
        "substeps": (int, None),
    },
    build=_built,
    parameters=lambda given: (*_law_of(given).parameters(), *MODEL_PARAMETERS),
    parameter_unit=lambda name, given, unknown: PARAMETER_UNITS.get(name),
    moved_channel="restoring_force",
)
