"""An N-storey shear frame with a Bouc-Wen-Baber-Noori spring in every storey."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, ClassVar, Literal

import numpy as np

from structid.core.channels import check_channels
from structid.core.errors import InputError
from structid.core.hashing import digest
from structid.core.keys import Fraction
from structid.core.validation import check_arguments
from structid.engine.array_module import namespace
from structid.engine.device import jnp
from structid.engine.time_loop import TimeLoop
from structid.ground_motion.excitation import Excitation
from structid.mechanics.runge_kutta import runge_kutta_loop
from structid.models.derived_quantity import DerivedQuantity
from structid.models.hysteretic.frame_equations import FrameEquations, natural_frequencies
from structid.models.hysteretic.frame_settings import (
    check_damping,
    check_frame_excitation,
    loop_channels_of_storeys,
    one_or_each,
)
from structid.models.hysteretic.hysteretic_parameters import (
    DEFAULT_SUBSTEPS,
    LATER_TERMS,
    PARAMETER_UNITS,
    check_free,
    finite_number,
    parameter_unit,
    refuse_units_of_shapes,
)
from structid.models.hysteretic.prior_checks import check_priors, check_value
from structid.models.hysteretic.yield_point import yield_point
from structid.models.model_kind import ModelKind
from structid.models.traceable import TraceableModel, TracedExcitation
from structid.probability.space import ParameterSpace

STOREY_PARAMETERS = (
    "mass",
    "stiffness",
    "alpha",
    "beta",
    "gamma",
    "gamma_ratio",
    "exponent",
    "amplitude",
    "delta_a",
    "delta_nu",
    "delta_eta",
    "zeta0",
    "p",
    "q",
    "psi0",
    "delta_psi",
    "lambda_",
    "asymmetry",
)
"""Parameters of every storey; `stiffness` means the stiffness of all storeys, `stiffness_2` of the second storey only."""
MOST_STOREYS = 200
"""Largest number of storeys; without a limit, a mistyped number would fill the memory with parameter names."""

STOREY_CHANNELS = (
    "displacement",
    "velocity",
    "relative_acceleration",
    "absolute_acceleration",
    "drift",
    "restoring_force",
    "hysteretic_displacement",
    "hysteretic_energy",
    "elastic_energy",
    "absorbed_energy",
)
"""Channels of every storey: ``drift_2`` belongs to the second storey; the restoring force is the storey shear."""

Storeys = float | Sequence[float] | None


@check_arguments
@dataclass(frozen=True, eq=False)
class ShearFrame(TraceableModel):
    """Shear frame: floor masses joined by hysteretic springs, fixed at the base.

    With the drifts d_j = u_j − u_(j−1) and the storey shears f_j = k_j (α_j d_j + (1 − α_j) z_j)::

        m_j u_j″ = −m_j a_g − (C u′)_j − f_j + f_(j+1)
        z_j′ = the Bouc-Wen-Baber-Noori law of d_j′, degrading with e_h,j
        e_h,j′ = (1 − α_j) k_j/m_j z_j d_j′                                    (energy per mass of that storey)

    C is either the modal damping matrix C = M^½ 2ζ (M^(−½) K M^(−½))^½ M^½, in which every mode has ζ, or Rayleigh damping
    a M + b K with ζ in the first mode and in `rayleigh_mode`. Both use the initial stiffness. One storey equals `BoucWen`.

    Every storey parameter is one number for all storeys, or a sequence from the ground up. In `free`, a plain name
    (``"stiffness"``) means one value for all storeys. A numbered name (``"stiffness_2"``) means this storey only, and
    overrides any other value.

    Parameters
    ----------
    storeys : int
        Number of storeys N.
    mass, stiffness : float or sequence
        Floor masses [kg] and initial storey stiffnesses [N/m].
    alpha, beta, gamma, gamma_ratio, exponent, amplitude : float or sequence
        Hysteretic law of the springs, see `BoucWen`; give exactly one of gamma and gamma_ratio.
    delta_a, delta_nu, delta_eta, zeta0, p, q, psi0, delta_psi, lambda_ : float or sequence
        Degradation and pinching, see `BoucWen`; none by default.
    asymmetry : float or sequence
        Strength under negative shears, relative to the strength under positive shears; 1 by default.
    damping_ratio : float
        ζ.
    damping : {"modal", "rayleigh"} or ndarray, shape (storey, storey)
        Kind of damping matrix, or the matrix itself [N s/m].
    rayleigh_mode : int
        The second mode with ζ: 3 by default, or the last mode if there are fewer.
    free : sequence of str
        Names of the parameters given with every run, in the order of the columns; ``damping_ratio`` is also allowed.
    channels : sequence of str
        Channels to record, such as ``"displacement_3"``, ``"drift_1"``, ``"base_shear"``.
    substeps : int
        Runge-Kutta steps per sample.

    Examples
    --------
    >>> import structid as si
    >>> law = dict(alpha=0.05, beta=63.0, gamma_ratio=0.5)
    >>> frame = si.ShearFrame(storeys=3, mass=12_000.0, stiffness=2e7, damping_ratio=0.03, **law)
    >>> print(frame)
    ShearFrame: 3 storeys, f 2.892, 8.102, 11.71 Hz
    """

    steps_setting: ClassVar[str] = "substeps"

    storeys: int
    mass: Storeys = None
    stiffness: Storeys = None
    alpha: Storeys = None
    beta: Storeys = None
    gamma: Storeys = None
    gamma_ratio: Storeys = None
    exponent: Storeys = 1.0
    amplitude: Storeys = 1.0
    delta_a: Storeys = 0.0
    delta_nu: Storeys = 0.0
    delta_eta: Storeys = 0.0
    zeta0: Storeys = 0.0
    p: Storeys = 0.0
    q: Storeys = 0.0
    psi0: Storeys = 0.0
    delta_psi: Storeys = 0.0
    lambda_: Storeys = 0.0
    asymmetry: Storeys = 1.0
    damping_ratio: float = 0.0
    damping: str | np.ndarray = "modal"
    rayleigh_mode: int = 3
    free: tuple[str, ...] = ()
    channels: tuple[str, ...] = ("displacement_1",)
    substeps: int = DEFAULT_SUBSTEPS

    def __post_init__(self) -> None:
        if not (isinstance(self.storeys, (int, np.integer)) and 1 <= self.storeys <= MOST_STOREYS):
            raise InputError("ShearFrame.storeys", f"{self.storeys!r}", f"a whole number from 1 to {MOST_STOREYS}")
        if not (isinstance(self.substeps, (int, np.integer)) and self.substeps >= 1):
            raise InputError("ShearFrame.substeps", f"{self.substeps!r}", "a whole number of 1 or more")
        names = ("damping_ratio", *STOREY_PARAMETERS, *(f"{n}_{j}" for n in STOREY_PARAMETERS for j in self._numbers))
        object.__setattr__(self, "free", check_free("ShearFrame", self.free, names))
        channels = ("base_shear", *(f"{c}_{j}" for c in STOREY_CHANNELS for j in self._numbers))
        object.__setattr__(self, "channels", check_channels("ShearFrame.channels", self.channels, channels))
        for name in STOREY_PARAMETERS:
            object.__setattr__(self, name, self._per_storey(name, getattr(self, name)))
        self._check_complete()
        check_value(
            "ShearFrame.damping_ratio", "damping_ratio", finite_number("ShearFrame.damping_ratio", self.damping_ratio)
        )
        check_damping("ShearFrame", self.damping, self.rayleigh_mode, self.storeys)

    @property
    def _numbers(self) -> range:
        return range(1, self.storeys + 1)

    def _per_storey(self, name: str, value: Storeys) -> float | tuple[float, ...] | None:
        """Return one float if all storeys share the value (terms fixed at zero can then be omitted), otherwise a tuple."""
        if value is None:
            return None
        given = [value] * self.storeys if np.ndim(value) == 0 else list(value)  # type: ignore[arg-type]
        values = tuple(finite_number(f"ShearFrame.{name}", v) for v in given)
        if name in ("mass", "stiffness", "exponent", "amplitude", "asymmetry") and min(values) <= 0.0:
            raise InputError(f"ShearFrame.{name}", f"{min(values):g}", "positive numbers")
        for value_of_storey in values:
            check_value(f"ShearFrame.{name}", name, value_of_storey)
        if name == "zeta0" and max(values) >= 1.0:
            raise InputError("ShearFrame.zeta0", f"{max(values):g}", "numbers below 1")
        if len(values) != self.storeys or not np.isfinite(values).all():
            raise InputError(f"ShearFrame.{name}", f"{list(values)}", f"one finite number, or {self.storeys} numbers")
        return values[0] if len(set(values)) == 1 else values

    def _given(self, name: str) -> bool:
        numbered = all(f"{name}_{j}" in self.free for j in self._numbers)
        return numbered or name in self.free or getattr(self, name) is not None

    def _check_every_storey(self, name: str) -> None:
        """Refuse a parameter that is free in some storeys and missing in others."""
        numbered = [n for n in self.free if n in {f"{name}_{j}" for j in self._numbers}]
        if numbered and not self._given(name):
            raise InputError(
                f"ShearFrame.{name}", f"only {', '.join(numbered)} is free", "a value or a prior for every storey"
            )

    def _check_complete(self) -> None:
        for name in ("mass", "stiffness", "alpha", "beta"):
            self._check_every_storey(name)
            if not self._given(name):
                raise InputError(
                    f"ShearFrame.{name}",
                    "the parameter has no value and is not free",
                    "numbers, or the name of the parameter in the argument free",
                )
        if self._named("gamma") == self._named("gamma_ratio"):
            raise InputError(
                "ShearFrame.gamma",
                "gamma and gamma_ratio are both given or both missing",
                "exactly one of the two, for all storeys",
            )
        for name in STOREY_PARAMETERS:
            self._check_every_storey(name)
        pinched = self._named("zeta0") and (self.zeta0 != 0.0 or any(n.startswith("zeta0") for n in self.free))
        if pinched and any(np.min(getattr(self, n)) <= 0.0 and n not in self.free for n in ("p", "psi0", "lambda_")):
            raise InputError(
                "ShearFrame pinching",
                "zeta0 without p, psi0 and lambda_",
                "positive p, psi0 and lambda_ if zeta0 is not 0",
            )

    def _named(self, name: str) -> bool:
        """Whether a parameter is given, for all storeys or for one storey."""
        names = {name, *(f"{name}_{j}" for j in self._numbers)}
        return getattr(self, name) is not None or bool(names & set(self.free))

    # --- response -----------------------------------------------------------------------------------------------

    def _values(self, theta: Any) -> dict[str, Any]:
        """Return every parameter by name: a float if fixed and equal in all storeys, else an array (storey, run) or (storey, 1)."""
        column = {name: theta[:, i] for i, name in enumerate(self.free)}
        numpy, values = namespace(theta), {}
        for name in STOREY_PARAMETERS:
            value: Any = column.get(name, getattr(self, name))
            if isinstance(value, tuple):
                value = numpy.array(value)[:, None]
            numbered = [j for j in self._numbers if f"{name}_{j}" in column]
            if numbered:
                base = 0.0 if value is None else value
                rows = numpy.broadcast_to(base, (self.storeys, theta.shape[0]))
                value = numpy.stack([column.get(f"{name}_{j}", rows[j - 1]) for j in self._numbers])
            values[name] = value
        if values["gamma"] is None:
            values["gamma"] = values["gamma_ratio"] * values["beta"]
        values["damping_ratio"] = column.get("damping_ratio", self.damping_ratio)
        return values

    def storey_values(self) -> dict[str, float | np.ndarray]:
        """Return every parameter of the storeys.

        Returns
        -------
        dict of str to float or ndarray, shape (storey,)
            Values in SI; one number if all storeys share the value. γ is given instead of its ratio to β.

        Raises
        ------
        InputError
            If a parameter is free.
        """
        if self.free:
            raise InputError("ShearFrame", f"free parameters: {', '.join(self.free)}", "a frame with fixed parameters")
        values = self._values(np.zeros((1, 0)))
        return {n: v if isinstance(v, float) else np.ravel(v) for n, v in values.items() if v is not None}

    def natural_frequency(self, theta: np.ndarray) -> np.ndarray:
        """Return the lowest frequency of the initial stiffness; see `Model.natural_frequency`."""
        values, shape = self._values(theta), (self.storeys, len(theta))
        mass, stiffness = (np.broadcast_to(values[name], shape).T for name in ("mass", "stiffness"))
        return np.array([natural_frequencies(k, m)[0] for k, m in zip(stiffness, mass, strict=True)])

    def derived_quantities(self, theta: np.ndarray) -> dict[str, DerivedQuantity]:
        """Return yield drift and yield force of every storey; see `Model.derived_quantities`."""
        shape = (self.storeys, len(theta))
        drift, force = (np.broadcast_to(v, shape) for v in yield_point(self._values(theta)))
        quantities = {f"yield drift of storey {j}": DerivedQuantity(drift[j - 1], "mm") for j in self._numbers}
        return quantities | {f"yield force of storey {j}": DerivedQuantity(force[j - 1], "kN") for j in self._numbers}

    def check_priors(self, space: ParameterSpace) -> None:
        """Refuse priors with a wrong unit or with unphysical values; see `Model.check_priors`."""
        check_priors(space, self.free, self)

    def check_excitation(self, excitation: Excitation) -> None:
        """Refuse several signals at once, and imposed displacements."""
        check_frame_excitation("ShearFrame", excitation)

    def time_loop(self, theta: Any, excitation: TracedExcitation) -> TimeLoop:
        """Return the loop over the record; see `TraceableModel.time_loop`."""
        equations = FrameEquations(
            self.storeys,
            self.channels,
            self._values(theta),
            excitation.kind,
            theta.shape[0],
            damping=self.damping,
            rayleigh_mode=self.rayleigh_mode,
        )
        # Zero times a column gives the state the run axis of the parameters.
        zero = jnp.zeros((self.storeys, theta.shape[0])) + (0.0 * theta[:, 0] if theta.shape[1] else 0.0)
        return runge_kutta_loop(
            equations.rate,
            lambda s: (s[0], s[1], s[2]),
            equations.observe,
            equations.initial_state(zero),
            excitation.stages,
            excitation.dt,
            excitation.dropped_samples,
            equations.watch(zero),
        )

    @property
    def content_hash(self) -> str:
        """Hash of all settings."""
        settings = {f.name: getattr(self, f.name) for f in fields(self) if f.name != "damping"}
        settings = {n: v for n, v in settings.items() if n not in LATER_TERMS or v != LATER_TERMS[n]}
        return digest(
            "ShearFrame", settings, np.asarray(self.damping) if not isinstance(self.damping, str) else self.damping
        )

    @property
    def loop_channels(self) -> dict[str, tuple[str, str, str]]:
        """Drift, shear and absorbed energy of every storey."""
        return loop_channels_of_storeys(self._numbers)

    @property
    def kind_in_words(self) -> str:
        """Descriptive name of the model."""
        return "shear frame"

    def recording(self, *channels: str) -> ShearFrame:
        """Return a copy of this frame that records other channels."""
        return replace(self, channels=channels)

    def frequencies(self) -> np.ndarray:
        """Compute the natural frequencies for the initial stiffness.

        Returns
        -------
        ndarray, shape (storey,)
            Frequencies [Hz] in ascending order.

        Raises
        ------
        InputError
            If masses or stiffnesses are free.
        """
        loose = [n for n in self.free if n.startswith(("mass", "stiffness"))]
        if loose:
            raise InputError(
                "ShearFrame.frequencies", f"free parameters: {', '.join(loose)}", "fixed masses and stiffnesses"
            )
        mass = np.broadcast_to(np.asarray(self.mass, dtype=np.float64), self.storeys)
        stiffness = np.broadcast_to(np.asarray(self.stiffness, dtype=np.float64), self.storeys)
        return natural_frequencies(stiffness, mass)

    def __str__(self) -> str:
        free = f", free: {', '.join(self.free)}" if self.free else ""
        if any(n.startswith(("mass", "stiffness")) for n in self.free):
            return f"ShearFrame: {self.storeys} storeys{free}"
        return f"ShearFrame: {self.storeys} storeys, f {', '.join(f'{f:.4g}' for f in self.frequencies())} Hz{free}"


def _parameters(given: Mapping[str, Any]) -> list[str]:
    """All parameter names of a frame."""
    storeys = min(given["storeys"], MOST_STOREYS)  # the constructor of the frame refuses more storeys
    numbered = [f"{name}_{j}" for name in STOREY_PARAMETERS for j in range(1, storeys + 1)]
    return ["damping_ratio", *STOREY_PARAMETERS, *numbered]


KIND = ModelKind(
    word="shear_frame",
    keys={
        **{name: (one_or_each(PARAMETER_UNITS[name]), None) for name in STOREY_PARAMETERS},
        "storeys": (int, ...),
        "damping_ratio": (Fraction, None),
        "damping": (Literal["modal", "rayleigh"], "modal"),
        "rayleigh_mode": (int, 3),
        "substeps": (int, None),
    },
    build=lambda asked: ShearFrame(free=asked.free, channels=asked.channels, **asked.given),
    parameters=_parameters,
    parameter_unit=parameter_unit,
    check=refuse_units_of_shapes,
    named_in_messages=tuple(name for name in PARAMETER_UNITS if name in ("damping_ratio", *STOREY_PARAMETERS)),
    note=" (and stiffness_2, …)",
)
