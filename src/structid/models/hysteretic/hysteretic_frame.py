"""Shear frame with a hysteretic law for each storey."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, ClassVar, Literal

import numpy as np
from jaxtyping import Float

from structid.core.channels import check_channels
from structid.core.errors import InputError, fixed_and_free, suggestion
from structid.core.hashing import digest
from structid.core.keys import Fraction
from structid.core.units import to_si
from structid.core.validation import check_arguments
from structid.engine.array_module import namespace
from structid.engine.device import jnp
from structid.engine.time_loop import TimeLoop
from structid.ground_motion.excitation import Excitation
from structid.mechanics.hysteretic_laws.base import HystereticLaw, LawParameter
from structid.mechanics.hysteretic_laws.law_list import LAWS, law_of
from structid.models.derived_quantity import DerivedQuantity
from structid.models.hysteretic.frame_equations import natural_frequencies
from structid.models.hysteretic.frame_settings import (
    check_damping,
    check_frame_excitation,
    loop_channels_of_storeys,
    one_or_each,
)
from structid.models.hysteretic.hysteretic_parameters import DEFAULT_SUBSTEPS, check_free
from structid.models.hysteretic.law_frame import LawFrame
from structid.models.hysteretic.law_values import (
    MODEL_PARAMETERS,
    PARAMETER_UNITS,
    check_law_priors,
    check_law_value,
)
from structid.models.model_kind import ModelKind, ModelRequest
from structid.models.traceable import TraceableModel, TracedExcitation
from structid.probability.space import ParameterSpace

MOST_STOREYS = 50
"""Largest number of storeys."""
EACH_STOREY = "a law for each storey, from the ground up"
"""The laws that a frame needs, in messages."""

STOREY_CHANNELS = (
    "displacement",
    "velocity",
    "relative_acceleration",
    "absolute_acceleration",
    "drift",
    "restoring_force",
    "absorbed_energy",
)
"""Channels of every storey: ``drift_2`` belongs to the second storey; the restoring force is the storey shear."""


@check_arguments
@dataclass(frozen=True, eq=False)
class HystereticFrame(TraceableModel):
    """Shear frame, fixed at the base, whose storeys are springs with hysteretic laws.

    With the drifts d_j = u_j − u_(j−1) and the storey shears f_j = law_j(d_j)::

        m_j u_j″ = −m_j a_g − (C u′)_j − f_j + f_(j+1)

    C is the modal damping matrix, in which every mode has ζ, or Rayleigh damping with ζ in the first mode and in `rayleigh_mode`.
    Both use the initial stiffness. One storey equals `Hysteretic`.

    A plain name (``"stiffness"``) is the parameter of all storeys whose law has it. A numbered name (``"stiffness_2"``) is that
    of one storey, counted from the ground; it overrides the plain name.

    Parameters
    ----------
    laws : sequence of str or HystereticLaw
        Law of every storey, from the ground up, such as ``["bilinear", "linear", "linear"]``.
    mass : float or sequence of float, optional
        Floor masses [kg]: one number, or one for each floor. Without a value, the mass is free.
    values : mapping of str to float, str or sequence
        Parameters of the laws in SI, or with a unit, such as ``{"stiffness": "22 kN/mm", "yield_force_1": "60 kN"}``. A sequence
        has a value for every storey whose law has the parameter. Others keep the law's default.
    damping_ratio : float
        ζ.
    damping : {"modal", "rayleigh"} or ndarray, shape (storey, storey)
        Kind of damping matrix, or the matrix itself [N s/m].
    rayleigh_mode : int
        The second mode with ζ: 3 by default, or the last mode if there are fewer.
    free : sequence of str
        Names of the parameters given with every run, in the order of the columns; ``mass``, ``mass_2`` and ``damping_ratio`` are
        also allowed.
    channels : sequence of str
        Channels to record, such as ``"absolute_acceleration_3"``, ``"drift_1"``, ``"base_shear"``.
    substeps : int
        Runge-Kutta steps per sample.

    Raises
    ------
    InputError
        If no law has a parameter, a value is missing or impossible, or a name is both free and given.

    Examples
    --------
    >>> import structid as si
    >>> frame = si.HystereticFrame(
    ...     ["bilinear", "linear", "linear"],
    ...     mass=12e3,
    ...     values={"stiffness": "20 kN/mm", "yield_force_1": "60 kN", "hardening_1": 0.05},
    ...     damping_ratio=0.03,
    ... )
    >>> print(frame)
    HystereticFrame: bilinear, linear, linear; f 2.892, 8.102, 11.71 Hz
    """

    steps_setting: ClassVar[str] = "substeps"
    hint_where_not_finite: ClassVar[str] = ""

    laws: Sequence[str | HystereticLaw]
    mass: float | Sequence[float] | None = None
    values: Mapping[str, Any] = field(default_factory=dict)
    damping_ratio: float = 0.0
    damping: str | np.ndarray = "modal"
    rayleigh_mode: int = 3
    free: tuple[str, ...] = ()
    channels: tuple[str, ...] = ("displacement_1",)
    substeps: int = DEFAULT_SUBSTEPS

    def __post_init__(self) -> None:
        laws = tuple(law_of("HystereticFrame.laws", law) for law in self.laws)
        if not 1 <= len(laws) <= MOST_STOREYS:
            raise InputError("HystereticFrame.laws", f"{len(laws)} storeys", f"1 to {MOST_STOREYS} storeys")
        object.__setattr__(self, "laws", laws)
        self._check_storeys()
        if not (isinstance(self.substeps, (int, np.integer)) and self.substeps >= 1):
            raise InputError("HystereticFrame.substeps", f"{self.substeps!r}", "a whole number of 1 or more")
        object.__setattr__(self, "free", check_free("HystereticFrame", self.free, tuple(self._described)))
        channels = ("base_shear", *(f"{c}_{j}" for c in STOREY_CHANNELS for j in self._numbers))
        object.__setattr__(self, "channels", check_channels("HystereticFrame.channels", self.channels, channels))
        object.__setattr__(self, "values", self._numbered(self.values))
        object.__setattr__(self, "laws", tuple(self._with_values(j) for j in self._numbers))
        self._check_masses()
        self._check_damping()

    def _check_storeys(self) -> None:
        """Refuse fewer laws than there are storeys by the masses and by the numbers of the parameters."""
        count = len(self.laws)
        _check_masses_of("HystereticFrame.laws", count, self.mass)
        for name in (self.free,) if isinstance(self.free, str) else (*self.free, *self.values):
            plain, _, number = name.rpartition("_")
            if plain in {"mass", *self._plain_names} and number.isdigit() and int(number) > count:
                raise InputError("HystereticFrame.laws", f"{count} laws, and '{name}' for storey {number}", EACH_STOREY)

    @property
    def _numbers(self) -> range:
        return range(1, len(self.laws) + 1)

    @property
    def _storey_laws(self) -> tuple[HystereticLaw, ...]:
        return self.laws  # type: ignore[return-value]

    def _storeys_with(self, name: str) -> list[int]:
        """Numbers of the storeys whose law has a parameter."""
        return [j for j, law in zip(self._numbers, self._storey_laws, strict=True) if name in law.parameters()]

    @property
    def _described(self) -> dict[str, LawParameter]:
        """Descriptions of all parameters, plain and numbered."""
        described = {name: MODEL_PARAMETERS[name] for name in ("damping_ratio", "mass")}
        described |= {f"mass_{j}": MODEL_PARAMETERS["mass"] for j in self._numbers}
        for law in self._storey_laws:
            described |= law.parameters()
        for j, law in zip(self._numbers, self._storey_laws, strict=True):
            described |= {f"{name}_{j}": parameter for name, parameter in law.parameters().items()}
        return described

    def _numbered(self, given: Mapping[str, Any]) -> dict[str, float]:
        """Return the given values of the laws in SI by their numbered names."""
        described, plain_names, values = self._described, self._plain_names, {}
        # Numbered names come last: they override plain ones.
        for name, value in sorted(given.items(), key=lambda item: item[0] not in plain_names):
            where = f"HystereticFrame.values['{name}']"
            if name not in described or name.startswith("mass") or name == "damping_ratio":
                allowed = [n for n in described if not n.startswith("mass") and n != "damping_ratio"]
                raise InputError(where, "no storey has this parameter", ", ".join(allowed), suggestion(name, allowed))
            storeys = self._storeys_with(name) if name in plain_names else [int(name.rpartition("_")[2])]
            plain = name if name in plain_names else name.rpartition("_")[0]
            each: list[Any] = [value] * len(storeys) if isinstance(value, str) or np.ndim(value) == 0 else list(value)
            if len(each) != len(storeys):
                raise InputError(where, f"{len(each)} values", f"one value, or {len(storeys)}: one for each storey")
            for j, one in zip(storeys, each, strict=True):
                number = to_si(one, described[name].unit, where)
                check_law_value(where, name, number, described[name])
                values[f"{plain}_{j}"] = number
        return values

    @property
    def _plain_names(self) -> set[str]:
        return {name for law in self._storey_laws for name in law.parameters()}

    def _with_values(self, storey: int) -> HystereticLaw:
        """Return the law of a storey with its given values; refuse missing ones, and those that are also free."""
        law, given = self._storey_laws[storey - 1], {}
        for name, described in law.parameters().items():
            numbered = f"{name}_{storey}"
            is_free, value = numbered in self.free or name in self.free, self.values.get(numbered)
            if is_free and value is not None:
                raise fixed_and_free(f"HystereticFrame.values['{numbered}']")
            if value is not None:
                given[name] = value
            elif not is_free and getattr(law, name) is None:
                raise InputError(
                    f"HystereticFrame.values['{numbered}']",
                    f"the {described.meaning} of storey {storey} has no value and is not free",
                    f"a number{f' in {described.unit}' if described.unit else ''}, or the name in the argument free",
                )
        return law.with_values(given)

    def _check_masses(self) -> None:
        free = [j for j in self._numbers if f"mass_{j}" in self.free or "mass" in self.free]
        if self.mass is None:
            if len(free) < len(self.laws):
                raise InputError("HystereticFrame.mass", "no mass", "masses in kg, or the name in the argument free")
            return
        if free:
            raise fixed_and_free("HystereticFrame.mass", "the mass")
        masses = np.atleast_1d(np.asarray(self.mass, dtype=np.float64))
        if masses.size not in (1, len(self.laws)) or not (masses > 0.0).all() or not np.isfinite(masses).all():
            raise InputError(
                "HystereticFrame.mass", f"{self.mass}", f"one positive number, or {len(self.laws)} positive numbers"
            )

    def _check_damping(self) -> None:
        check_law_value(
            "HystereticFrame.damping_ratio",
            "damping_ratio",
            float(self.damping_ratio),
            MODEL_PARAMETERS["damping_ratio"],
        )
        check_damping("HystereticFrame", self.damping, self.rayleigh_mode, len(self.laws))

    # --- response -----------------------------------------------------------------------------------------------

    def _values(self, theta: Any) -> tuple[list[HystereticLaw], Any, Any]:
        """Return the laws with arrays over runs for free parameters, the masses (storey, run), and the damping ratio."""
        numpy = namespace(theta)
        column = {name: theta[:, i] for i, name in enumerate(self.free)}
        like = 0.0 * theta[:, 0] if theta.shape[1] else numpy.zeros(theta.shape[0])
        laws = []
        for j, law in zip(self._numbers, self._storey_laws, strict=True):
            names = {name: column.get(f"{name}_{j}", column.get(name)) for name in law.parameters()}
            laws.append(law.with_values({name: value for name, value in names.items() if value is not None}))
        fixed = np.ones(len(laws)) if self.mass is None else np.broadcast_to(np.asarray(self.mass, float), len(laws))
        masses = [column.get(f"mass_{j}", column.get("mass", float(fixed[j - 1]))) + like for j in self._numbers]
        return laws, numpy.stack(masses), column.get("damping_ratio", self.damping_ratio)

    def time_loop(self, theta: Any, excitation: TracedExcitation) -> TimeLoop:
        """Return the loop over the samples; see `TraceableModel.time_loop`."""
        laws, mass, damping_ratio = self._values(theta)
        motion = LawFrame(
            laws, jnp.asarray(mass), self.damping, self.rayleigh_mode, damping_ratio, self.channels, excitation.kind
        )
        return motion.time_loop(excitation.stages, excitation.dt, excitation.dropped_samples)

    def natural_frequency(self, theta: np.ndarray) -> np.ndarray:
        """Return the lowest frequency of the initial stiffness; see `Model.natural_frequency`."""
        return self._frequencies(theta)[:, 0]

    def _frequencies(self, theta: np.ndarray) -> Float[np.ndarray, "run storey"]:
        """Return the natural frequencies of the initial stiffness in ascending order [Hz]."""
        laws, mass, _ = self._values(np.asarray(theta))
        stiffness = np.stack([np.broadcast_to(law.stiffness, len(theta)) for law in laws], axis=1)
        return np.array([natural_frequencies(k, m) for k, m in zip(stiffness, mass.T, strict=True)])

    def derived_quantities(self, theta: np.ndarray) -> dict[str, DerivedQuantity]:
        """Return the yield drift of every storey that yields; see `Model.derived_quantities`."""
        quantities = {}
        for j, law in zip(self._numbers, self._values(np.asarray(theta))[0], strict=True):
            if "yield_force" in law.parameters():
                drift = np.broadcast_to(law.yield_force / law.stiffness, len(theta))  # type: ignore[attr-defined]
                quantities[f"yield drift of storey {j}"] = DerivedQuantity(drift, "mm")
        return quantities

    # --- checks -------------------------------------------------------------------------------------------------

    def check_excitation(self, excitation: Excitation) -> None:
        """Refuse several signals at once, and imposed displacements."""
        check_frame_excitation("HystereticFrame", excitation)

    def check_priors(self, space: ParameterSpace) -> None:
        """Refuse priors with a wrong unit or with impossible values; see `Model.check_priors`."""
        check_law_priors(space, self.free, self._described)

    @property
    def content_hash(self) -> str:
        """Hash of all settings."""
        settings = {f.name: getattr(self, f.name) for f in fields(self) if f.name not in ("laws", "values", "damping")}
        laws = [{"law": law.word} | {f.name: getattr(law, f.name) for f in fields(law)} for law in self._storey_laws]
        damping = self.damping if isinstance(self.damping, str) else np.asarray(self.damping)
        return digest("HystereticFrame", laws, settings, damping)

    # --- description --------------------------------------------------------------------------------------------

    @property
    def loop_channels(self) -> dict[str, tuple[str, str, str]]:
        """Drift, shear and absorbed energy of every storey."""
        return loop_channels_of_storeys(self._numbers)

    @property
    def kind_in_words(self) -> str:
        """Descriptive name of the model."""
        return "shear frame with hysteretic laws"

    def recording(self, *channels: str) -> HystereticFrame:
        """Return a copy of this frame that records other channels."""
        return replace(self, channels=channels)

    def __str__(self) -> str:
        laws = ", ".join(law.word for law in self._storey_laws)
        if self.free:
            return f"HystereticFrame: {laws}; free: {', '.join(self.free)}"
        return f"HystereticFrame: {laws}; f {', '.join(f'{f:.4g}' for f in self._frequencies(np.zeros((1, 0)))[0])} Hz"


def _check_masses_of(where: str, laws: int, mass: Any) -> None:
    """Refuse fewer laws than masses."""
    if np.size(mass) > max(1, laws):
        raise InputError(where, f"{laws} laws and {np.size(mass)} masses", EACH_STOREY)


def _laws_of(given: Mapping[str, Any]) -> tuple[HystereticLaw, ...]:
    """Return the laws that a table names."""
    return tuple(law_of("key 'model.laws'", name) for name in given["laws"])


def _parameters(given: Mapping[str, Any]) -> list[str]:
    """All parameter names of a frame."""
    names, laws = ["damping_ratio", "mass"], _laws_of(given)
    _check_masses_of("key 'model.laws'", len(laws), given.get("mass"))
    for j, law in enumerate(laws, start=1):
        names += [f"mass_{j}", *law.parameters(), *(f"{name}_{j}" for name in law.parameters())]
    return list(dict.fromkeys(names))


def _built(asked: ModelRequest) -> HystereticFrame:
    given = dict(asked.given)
    own = ("laws", "mass", "damping_ratio", "damping", "rayleigh_mode", "substeps")
    settings = {name: given.pop(name) for name in own if name in given}
    return HystereticFrame(values=given, free=asked.free, channels=asked.channels, **settings)


def _unit(name: str, given: Mapping[str, Any], unknown: Any) -> str | None:
    """SI unit of a parameter, plain or numbered."""
    plain, _, number = name.rpartition("_")
    return PARAMETER_UNITS.get(name, PARAMETER_UNITS.get(plain) if number.isdigit() else None)


OF_LAWS = {name: unit for name, unit in PARAMETER_UNITS.items() if name not in MODEL_PARAMETERS}
"""SI unit of every parameter of the laws."""

KIND = ModelKind(
    word="hysteretic_frame",
    keys={
        **{name: (one_or_each(unit), None) for name, unit in OF_LAWS.items()},
        "laws": (tuple.__class_getitem__((Literal[tuple(LAWS)], ...)), ...),
        "mass": (one_or_each("kg"), None),
        "damping_ratio": (Fraction, None),
        "damping": (Literal["modal", "rayleigh"], "modal"),
        "rayleigh_mode": (int, 3),
        "substeps": (int, None),
    },
    build=_built,
    parameters=_parameters,
    parameter_unit=_unit,
    note=" (and so on, for every law in model.laws)",
)
