"""The single-degree-of-freedom Bouc-Wen-Baber-Noori oscillator.

Numbers in brackets, such as [3.12], are equations of the MSc thesis in docs/bibliography.md.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from structid.core.channels import check_channels
from structid.core.errors import InputError, fixed_and_free, suggestion
from structid.core.hashing import digest
from structid.core.keys import quantity
from structid.core.units import factor
from structid.core.validation import check_arguments
from structid.engine.device import jnp
from structid.engine.time_loop import TimeLoop
from structid.ground_motion.excitation import Excitation, check_one_signal
from structid.mechanics.hysteresis import Law
from structid.mechanics.restoring_forces import HystereticSprings
from structid.mechanics.runge_kutta import runge_kutta_loop
from structid.models.derived_quantity import DerivedQuantity
from structid.models.hysteretic.hysteretic_parameters import (
    DEFAULT_SUBSTEPS,
    LATER_TERMS,
    PARAMETER_UNITS,
    check_free,
    finite_number,
    parameter_unit,
    refuse_units_of_shapes,
)
from structid.models.hysteretic.oscillator_equations import OscillatorEquations
from structid.models.hysteretic.prior_checks import PHYSICAL_RANGES, check_priors, check_value
from structid.models.hysteretic.yield_point import yield_point
from structid.models.model_kind import ModelKind
from structid.models.traceable import TraceableModel, TracedExcitation
from structid.probability.space import ParameterSpace

if TYPE_CHECKING:
    from matplotlib.figure import Figure

CHANNELS = (
    "displacement",
    "velocity",
    "relative_acceleration",
    "absolute_acceleration",
    "restoring_force",
    "hysteretic_displacement",
    "hysteretic_energy",
    "elastic_energy",
    "absorbed_energy",
)
"""Channels of the oscillator."""

_REQUIRED = ("mass", "stiffness", "alpha", "beta")
_EITHER = (("gamma", "gamma_ratio"), ("damping_ratio", "damping"))


@check_arguments
@dataclass(frozen=True, eq=False)
class BoucWen(TraceableModel):
    """Oscillator with a Bouc-Wen-Baber-Noori spring (degradation with absorbed energy, pinching).

    ::

        u″ = −a_g − c/m v − α ω² u − (1−α) ω² z,       ω² = k_i/m,  c = 2 ζ ω m              [3.12]
        z′ = h(z) {A v − ν [β |v| |z|^(n−1) z + γ v |z|ⁿ]} / η                               [3.4]
        e_h′ = (1−α) ω² z v,     e_e′ = α ω² u v                                             [3.14, 3.15]
        A = A₀ − δ_A e_h,   ν = 1 + δ_ν e_h,   η = 1 + δ_η e_h                               [3.5]

    The restoring force is m (α ω² u + (1−α) ω² z). The excitation can be a `GroundMotion`, a `ForceHistory`, or a
    `DisplacementHistory`. With a `DisplacementHistory` the displacement is imposed, and the response is the restoring force
    without the viscous part. e_h + e_e is the energy *absorbed* by the spring per mass. The thesis calls it dissipated, but
    part of it is recoverable, so degradation driven by e_h can occur in elastic cycling. The hysteretic law is
    bounded-input-bounded-output stable for ``|γ| ≤ β``; the model does not enforce this condition.

    Every parameter either has a value here or is named in `free`.

    Parameters
    ----------
    mass : float
        m [kg].
    stiffness : float
        Initial stiffness k_i [N/m].
    alpha : float
        Ratio of final to initial stiffness.
    beta : float
        β [m⁻ⁿ].
    gamma, gamma_ratio : float
        γ [m⁻ⁿ], or γ/β: give exactly one of the two.
    damping_ratio, damping : float
        ζ relative to the initial stiffness, or c [N s/m]. Give at most one; the default is no damping.
    exponent : float
        n, 1 by default.
    amplitude : float
        A₀, 1 by default.
    delta_a, delta_nu, delta_eta : float
        Rates of degradation δ_A, δ_ν, δ_η [kg/J], 0 by default.
    zeta0, p, q, psi0, delta_psi, lambda_ : float
        Pinching parameters ζ₀ < 1, p [kg/J], q, ψ₀ [m], δ_ψ [m kg/J], λ; no pinching by default.
    asymmetry : float
        ρ, strength under negative forces relative to the strength under positive forces; 1 by default.
    force_offset : float
        F₀ [N], part of the recorded restoring force only, such as a load cell's zero; it does not move the mass.
    initial_displacement, initial_velocity, initial_hysteretic_displacement : float
        State at the first sample [m, m/s, m], 0 by default.
    free : sequence of str
        Parameters that are given with every run instead, in the order of its columns.
    channels : sequence of str
        Channels to record, from `CHANNELS`; energies are in J.
    substeps : int
        Runge-Kutta steps per sample.

    Examples
    --------
    >>> import structid as si
    >>> model = si.BoucWen(mass=12_000.0, stiffness=7.6e6, damping_ratio=0.03, alpha=0.05, beta=63.0, gamma_ratio=1.0)
    >>> print(model)
    BoucWen: f 4.005 Hz, T 0.2497 s, ω_n 25.17 rad/s, ω_d 25.15 rad/s, c 1.812e+04 N s/m
    """

    steps_setting: ClassVar[str] = "substeps"

    mass: float | None = None
    stiffness: float | None = None
    alpha: float | None = None
    beta: float | None = None
    gamma: float | None = None
    gamma_ratio: float | None = None
    damping_ratio: float | None = None
    damping: float | None = None
    exponent: float = 1.0
    amplitude: float = 1.0
    delta_a: float = 0.0
    delta_nu: float = 0.0
    delta_eta: float = 0.0
    zeta0: float = 0.0
    p: float = 0.0
    q: float = 0.0
    psi0: float = 0.0
    delta_psi: float = 0.0
    lambda_: float = 0.0
    asymmetry: float = 1.0
    force_offset: float = 0.0
    initial_displacement: float = 0.0
    initial_velocity: float = 0.0
    initial_hysteretic_displacement: float = 0.0
    free: tuple[str, ...] = ()
    channels: tuple[str, ...] = ("velocity",)
    substeps: int = DEFAULT_SUBSTEPS

    def __post_init__(self) -> None:
        free = check_free(type(self).__name__, self.free, tuple(PARAMETER_UNITS))
        object.__setattr__(self, "free", free)
        object.__setattr__(self, "channels", check_channels(f"{type(self).__name__}.channels", self.channels, CHANNELS))
        if not (isinstance(self.substeps, (int, np.integer)) and self.substeps >= 1):
            raise InputError("BoucWen.substeps", f"{self.substeps!r}", "a whole number of 1 or more")
        for name in PARAMETER_UNITS:
            value = getattr(self, name)
            if value is not None:
                object.__setattr__(self, name, finite_number(f"BoucWen.{name}", value))
        self._check_complete()
        self._check_values()

    def _given(self, name: str) -> bool:
        return name in self.free or getattr(self, name) is not None

    def _check_complete(self) -> None:
        for name in _REQUIRED:
            if not self._given(name):
                raise InputError(
                    f"BoucWen.{name}",
                    "the parameter has no value and is not free",
                    f"a number{f' in {PARAMETER_UNITS[name]}' if PARAMETER_UNITS[name] else ''}, or the name of the parameter "
                    "in the argument free",
                )
        for name in (*_REQUIRED, *(n for pair in _EITHER for n in pair)):
            if name in self.free and getattr(self, name) is not None:
                raise fixed_and_free(f"BoucWen.{name}")
        for first, second in _EITHER:
            if self._given(first) and self._given(second):
                raise InputError(
                    f"BoucWen.{first}",
                    f"both {first} and {second} are given",
                    "only one of the two",
                    f"Remove {second}.",
                )
        if not (self._given("gamma") or self._given("gamma_ratio")):
            raise InputError("BoucWen.gamma", "neither gamma nor gamma_ratio is given", "exactly one of the two")

    def _check_values(self) -> None:
        for name in ("mass", "stiffness", "exponent", "amplitude", "asymmetry"):
            value = getattr(self, name)
            if value is not None and name not in self.free and value <= 0.0:
                raise InputError(f"BoucWen.{name}", f"{value:g}", "a positive number")
        for name in PHYSICAL_RANGES:
            if (value := getattr(self, name)) is not None and name not in self.free:
                check_value(f"BoucWen.{name}", name, value)
        if self.zeta0 >= 1.0:
            raise InputError(
                "BoucWen.zeta0",
                f"{self.zeta0:g}",
                "a number below 1",
                "At zeta0 = 1 the spring has no stiffness in the pinched range. Use 0.95 if your source gives 1.",
            )
        if (self.zeta0 != 0.0 or "zeta0" in self.free) and any(
            getattr(self, name) <= 0.0 and name not in self.free for name in ("p", "psi0", "lambda_")
        ):
            raise InputError(
                "BoucWen pinching",
                f"zeta0 with p = {self.p:g}, psi0 = {self.psi0:g}, lambda_ = {self.lambda_:g}",
                "positive p, psi0 and lambda_ if zeta0 is not 0",
            )

    # --- response -----------------------------------------------------------------------------------------------

    def _values(self, theta: Any) -> dict[str, Any]:
        """Return every parameter by name: floats for fixed parameters, arrays over runs for free parameters."""
        values = {name: getattr(self, name) for name in PARAMETER_UNITS}
        values.update({name: theta[:, i] for i, name in enumerate(self.free)})
        if values["gamma"] is None:
            values["gamma"] = values["gamma_ratio"] * values["beta"]
        return values

    def check_priors(self, space: ParameterSpace) -> None:
        """Refuse priors with a wrong unit or with unphysical values; see `Model.check_priors`."""
        check_priors(space, self.free, self)

    def check_excitation(self, excitation: Excitation) -> None:
        """Refuse several signals at once, and acceleration channels under imposed displacements."""
        check_one_signal("BoucWen", excitation)
        forbidden = set(self.channels) & {"relative_acceleration", "absolute_acceleration"}
        if excitation.kind == "displacement" and forbidden:
            raise InputError(
                "channels",
                "acceleration channels with an imposed displacement",
                "displacement, velocity, restoring_force, …",
            )

    def time_loop(self, theta: Any, excitation: TracedExcitation) -> TimeLoop:
        """Return the loop over the record; see `TraceableModel.time_loop`."""
        equations = OscillatorEquations(self._values(theta), self.channels, excitation.kind)
        each = theta[:, 0] if theta.shape[1] else jnp.zeros(theta.shape[0])
        return runge_kutta_loop(
            equations.rate,
            equations.inputs(excitation.dt / self.substeps),
            equations.observe,
            equations.initial_state(each),
            excitation.stages,
            excitation.dt,
            excitation.dropped_samples,
            equations.watch(jnp.zeros_like(each)),
        )

    def static_force(self, theta: Any) -> HystereticSprings:
        """Return the spring without mass and dashpot; see `TraceableModel.static_force`."""
        values = {n: v if isinstance(v, float) else v[None] for n, v in self._values(theta).items() if v is not None}
        law = Law(**{name: values[name] for name in Law._fields})
        k, m = (np.array([v]) if isinstance(v, float) else v for v in (values["stiffness"], values["mass"]))
        return HystereticSprings(np.ones((1, 1)), k, m, law)

    def natural_frequency(self, theta: np.ndarray) -> np.ndarray:
        """Return the frequency of the initial stiffness; see `Model.natural_frequency`."""
        values = self._values(theta)
        return np.broadcast_to(np.sqrt(values["stiffness"] / values["mass"]) / (2.0 * np.pi), len(theta))

    def derived_quantities(self, theta: np.ndarray) -> dict[str, DerivedQuantity]:
        """Return yield displacement and yield force; see `Model.derived_quantities`."""
        displacement, force = (np.broadcast_to(v, len(theta)) for v in yield_point(self._values(theta)))
        return {"yield displacement": DerivedQuantity(displacement, "mm"), "yield force": DerivedQuantity(force, "kN")}

    @property
    def content_hash(self) -> str:
        """Hash of all settings."""
        # A model without the terms of later versions has the hash of the earlier ones, so that their stores can be continued.
        settings = {f.name: getattr(self, f.name) for f in fields(self)}
        return digest("BoucWen", {n: v for n, v in settings.items() if n not in LATER_TERMS or v != LATER_TERMS[n]})

    # --- description --------------------------------------------------------------------------------------------

    def properties(self) -> dict[str, float]:
        """Compute frequency and damping for the initial stiffness.

        Returns
        -------
        dict of str to float
            ``f`` [Hz], ``T`` [s], ``omega_n``, ``omega_d`` [rad/s], ``c`` [N s/m].

        Raises
        ------
        InputError
            If mass, stiffness or damping is a free parameter.
        """
        loose = [n for n in ("mass", "stiffness", "damping_ratio", "damping") if n in self.free]
        if loose:
            raise InputError(
                "BoucWen.properties",
                f"free parameters: {', '.join(loose)}",
                "fixed values of mass, stiffness and damping",
                "Fix them with BoucWen.fixed(...).",
            )
        assert self.mass is not None and self.stiffness is not None
        omega = float(np.sqrt(self.stiffness / self.mass))
        zeta = self.damping_ratio or 0.0
        if self.damping is not None:
            zeta = self.damping / (2.0 * self.mass * omega)
        return {
            "f": omega / (2 * np.pi),
            "T": 2 * np.pi / omega,
            "omega_n": omega,
            "omega_d": omega * float(np.sqrt(max(1.0 - zeta**2, 0.0))),
            "c": 2.0 * zeta * omega * self.mass,
        }

    def fixed(self, **values: float) -> BoucWen:
        """Return a copy of this model in which some free parameters are fixed.

        Parameters
        ----------
        **values : float
            Values of the fixed parameters in SI.

        Returns
        -------
        BoucWen
            The model with fewer free parameters.
        """
        for name in values:
            if name not in self.free:
                raise InputError(
                    "BoucWen.fixed",
                    f"'{name}'",
                    ", ".join(self.free) or "no arguments, since no parameter is free",
                    suggestion(name, self.free),
                )
        return replace(self, free=tuple(n for n in self.free if n not in values), **values)  # type: ignore[arg-type]

    @property
    def loop_channels(self) -> dict[str, tuple[str, str, str]]:
        """Displacement, force and absorbed energy of the spring."""
        return {"": ("displacement", "restoring_force", "absorbed_energy")}

    @property
    def kind_in_words(self) -> str:
        """Descriptive name of the model."""
        return "Bouc–Wen oscillator"

    def recording(self, *channels: str) -> BoucWen:
        """Return a copy of this model that records other channels."""
        return replace(self, channels=channels)

    def __str__(self) -> str:
        free = f", free: {', '.join(self.free)}" if self.free else ""
        if any(n in self.free for n in ("mass", "stiffness", "damping_ratio", "damping")):
            return f"BoucWen: channels {', '.join(self.channels)}{free}"
        v = self.properties()
        return (
            f"BoucWen: f {v['f']:.4g} Hz, T {v['T']:.4g} s, ω_n {v['omega_n']:.4g} rad/s, "
            f"ω_d {v['omega_d']:.4g} rad/s, c {v['c']:.4g} N s/m{free}"
        )

    def plot_response(
        self,
        excitation: Excitation,
        theta: np.ndarray | None = None,
        save: str | os.PathLike[str] | None = None,
    ) -> Figure:
        """Draw displacement, velocity, restoring force and energy of one run.

        Parameters
        ----------
        excitation : Excitation
            Excitation of the model.
        theta : ndarray, shape (parameter,), optional
            The free parameters in SI; optional if there are none.
        save : path-like, optional
            File name without extension; a PNG and a PDF are written.

        Returns
        -------
        matplotlib.figure.Figure
            Figure with four panels.
        """
        from structid.figures import response as figure

        panels = ("displacement", "velocity", "restoring_force", "hysteretic_energy", "elastic_energy")
        row = np.zeros((1, 0)) if theta is None else np.asarray(theta, dtype=np.float64)[None, :]
        run = replace(self, channels=panels).simulate(row, excitation)
        units = ("mm", "mm/s", "kN", "J", "J")
        u, v, force, hysteretic, elastic = (run.channel(c)[0] / factor(x) for c, x in zip(panels, units, strict=True))
        return figure.four_panels(run.time, u, v, force, hysteretic, elastic, excitation.name, save)


KIND = ModelKind(
    word="bouc_wen",
    keys={**{name: (quantity(unit), None) for name, unit in PARAMETER_UNITS.items()}, "substeps": (int, None)},
    build=lambda asked: BoucWen(free=asked.free, channels=asked.channels, **asked.given),
    parameters=lambda given: PARAMETER_UNITS,
    parameter_unit=parameter_unit,
    check=refuse_units_of_shapes,
    moved_channel="restoring_force",
)
