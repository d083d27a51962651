"""Whether a hybrid test can work, before anything moves: its figures, what cannot work, what one should know."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import scipy
from jaxtyping import Float

from structid.hybrid.control.compensation import Compensation
from structid.hybrid.control.motion import Motion
from structid.hybrid.control.tracking import STIFFER, largest_secant
from structid.hybrid.coupling.base import Joined
from structid.hybrid.coupling.stability import free_oscillations, spectral_radius
from structid.hybrid.coupling.whole_structure import WholeStructure
from structid.hybrid.laboratory.specimen import SpecimenDescription
from structid.hybrid.substructures.substructure import Substructure

LARGEST_FINE_STEP = 0.5
"""ω_P Δt of a fine specimen that is coupled by a virtual step; beyond it its spurious damping is no longer small."""
ROUNDING = 1e-6
"""Of a stiffness and of an amplification that should be one or less."""
ABSURD = 1e3
"""Displacement [m] that no specimen comes to."""
TANGENT_ERROR = 1e-4
"""Of a stiffness that was probed, over K₀."""
PROBE = 1e-7
"""Displacement [m] by which the first tangent of what is expected is probed."""
SOFTENED = (1.0, 0.5, 0.3, 0.1, 0.03)
"""Shares of K₀ at which the damping of a softened specimen is looked at."""


@dataclass(frozen=True)
class Feasibility:
    """What is known of a test before it starts."""

    critical_delay: float  # λ τ_c [s] of wall time; infinite where every delay is borne
    delay: float  # Of the transfer system, as the specimen tells it [s]
    damping: tuple[float, ...]  # Damping ratio of every mode of the structure with that delay and the compensation
    # Least damping ratio, most often negative, that the coupling adds to a mode of a softened specimen
    spurious_damping: float
    # Largest displacement [m], velocity [m/s] and force [N] of every channel in a virtual run
    stroke: tuple[float, ...]
    # Largest displacement [m], velocity [m/s] and force [N] of every channel in a virtual run
    velocity: tuple[float, ...]
    force: tuple[float, ...]  # Largest displacement [m], velocity [m/s] and force [N] of every channel in a virtual run
    wall_time: float  # How long it will take [s]
    steps: int  # Coarse steps
    refusals: tuple[str, ...] = ()  # Why it cannot work; what one should know
    warnings: tuple[str, ...] = ()  # Why it cannot work; what one should know

    @property
    def can_work(self) -> bool:
        """Whether nothing speaks against it."""
        return not self.refusals

    def __str__(self) -> str:
        lines = [
            "This test can work." if self.can_work else "This test cannot work.",
            *(f"  - {refusal}" for refusal in self.refusals),
            *(f"  note: {warning}" for warning in self.warnings),
            f"critical delay      {1e3 * self.critical_delay:.1f} ms of wall time",
            f"delay               {1e3 * self.delay:.1f} ms of the transfer system",
            f"damping with it     {', '.join(f'{100.0 * z:.2f}' for z in self.damping)} %",
            f"spurious damping    {100.0 * self.spurious_damping:.2g} % at the worst softening",
            f"expected stroke     {', '.join(f'{1e3 * x:.2f}' for x in self.stroke)} mm",
            f"expected velocity   {', '.join(f'{1e3 * x:.2f}' for x in self.velocity)} mm/s of wall time",
            f"expected force      {', '.join(f'{1e-3 * x:.1f}' for x in self.force)} kN",
            f"duration            {self.steps} steps, {self.wall_time:.0f} s of wall time",
        ]
        return "\n".join(lines)


@dataclass(frozen=True, eq=False)
class Plan:
    """What a test is going to do, as far as it must be judged."""

    joined: Joined  # Both parts, the physical one with what it is expected to answer
    description: SpecimenDescription  # What the specimen says of itself
    geometry: Float[np.ndarray, "channel dof"]  # B
    motion: Motion  # Of the specimen
    compensation: Compensation | None  # Of the transfer system
    time_scale: float  # λ


@dataclass(frozen=True, eq=False)
class VirtualMoves:
    """What a specimen went through in a virtual run, with the force that is expected of it."""

    targets: Float[np.ndarray, "move channel"]  # Where it was moved to [m]
    forces: Float[np.ndarray, "move channel"]  # Its forces [N]
    collapse: str = ""  # How it failed; empty where it did not

    @property
    def bounded(self) -> bool:
        """Whether everything is finite, and no displacement absurd."""
        return bool(np.abs(self.targets).max() < ABSURD and np.isfinite(self.forces).all())


def commanded(plan: Plan, targets: Float[np.ndarray, "move channel"]) -> tuple[np.ndarray, np.ndarray]:
    """Say how far and how fast pistons will be commanded, with the compensation, which overshoots and makes small jumps fast."""
    step = plan.description.controller_step
    started = np.concatenate([0.0 * targets[:1], targets])
    if plan.compensation is None:
        moves = np.abs(np.diff(started, axis=0)).max(axis=0)
        duration = plan.time_scale * plan.joined.dt if plan.motion.settles else step
        return np.abs(targets).max(axis=0), moves * plan.motion.peak_rate / duration
    compensator = plan.compensation.begin(targets.shape[1], step, plan.time_scale)
    paths = (plan.motion.path(*ends) for ends in itertools.pairwise(started))
    commands = np.concatenate([compensator.commands(path) for path in paths])
    return np.abs(commands).max(axis=0), np.abs(np.diff(commands, axis=0, prepend=0.0 * commands[:1])).max(
        axis=0
    ) / step


def damping_with_delay(plan: Plan, whole: WholeStructure, delay: float) -> Float[np.ndarray, " mode"]:
    """Damping of every mode: ζ + p Im G/2, G = gain · e^(−iωτ)."""
    if not plan.motion.continuous:
        return whole.damping_ratios
    factors = np.array([_loop_factor(plan, omega, delay) for omega in whole.frequencies])
    return np.asarray(whole.damping_ratios + 0.5 * whole.shares * factors.imag)


def _loop_factor(plan: Plan, omega: float, delay: float) -> complex:
    """G = gain · e^(−iωτ), by which a loop multiplies the specimen's force at a frequency ω of simulated time."""
    turned = omega / plan.time_scale
    gain = 1.0 if plan.compensation is None else plan.compensation.gain(turned, delay)
    return complex(gain * np.exp(-1j * turned * delay))


def spurious_damping(plan: Plan) -> float:
    """Least damping that the coupling adds to a mode of a specimen that has softened, without any of its own."""
    numerical, physical = (side.part for side in (plan.joined.numerical, plan.joined.physical))
    found = [
        free_oscillations(plan.joined.of_parts(numerical.undamped().softened(1.0), physical.undamped().softened(share)))
        for share in SOFTENED
    ]
    return min(float(f.damping_ratios.min(initial=0.0)) for f in found)


def judged(plan: Plan, virtual: VirtualMoves, steps: int) -> Feasibility:
    """Judge a test by a virtual run."""
    whole = WholeStructure.of(plan.joined)
    delay = max(channel.delay for channel in plan.description.channels)
    with np.errstate(over="ignore", invalid="ignore"):
        stroke, velocity = commanded(plan, virtual.targets)
    found = Feasibility(
        plan.time_scale * whole.critical_delay.delay,
        delay,
        tuple(map(float, damping_with_delay(plan, whole, delay))),
        spurious_damping(plan),
        tuple(map(float, stroke)),
        tuple(map(float, velocity)),
        tuple(map(float, np.abs(virtual.forces).max(axis=0))),
        steps * plan.joined.dt * plan.time_scale,
        steps,
    )
    stiffness = largest_stiffness(plan, virtual)
    refusals = (*_late(plan, whole, found), *_unstable(plan, virtual, stiffness), *_beyond_limits(plan, found))
    return replace(
        found, refusals=refusals, warnings=(*_warnings(plan, found, stiffness), *filter(None, [virtual.collapse]))
    )


def largest_stiffness(plan: Plan, virtual: VirtualMoves) -> float:
    """Largest stiffness of the specimen over K₀, as it tells it or as it is expected."""
    stiffness, back = plan.joined.physical.part.stiffness, np.linalg.pinv(plan.geometry)
    found = [
        1.0,
        float(scipy.linalg.eigh(_first_tangent(plan.joined.physical.part), stiffness, eigvals_only=True).max()),
    ]
    if plan.description.stiffness is not None:
        told = plan.geometry.T @ np.array(plan.description.stiffness) @ plan.geometry
        found.append(float(scipy.linalg.eigh(told, stiffness, eigvals_only=True).max()))
    if virtual.bounded:
        secant = largest_secant(virtual.targets, virtual.targets, virtual.forces, back.T @ stiffness @ back)
        found += [secant] if secant > STIFFER else []
    return max(found)


def _first_tangent(part: Substructure) -> np.ndarray:
    """Of the force that is expected, by small moves from rest."""
    start = np.zeros(part.dofs)
    at_rest, memory = part.force.begin(start)
    columns = [(part.force.at(memory, PROBE * row)[0] - at_rest) / PROBE for row in np.eye(part.dofs)]
    tangent = np.column_stack(columns)
    return np.asarray(0.5 * (tangent + tangent.T))


def _late(plan: Plan, whole: WholeStructure, found: Feasibility) -> list[str]:
    """What is wrong with the delay, a sentence each."""
    if not plan.motion.continuous:
        waits = (plan.motion.samples - plan.motion.ramp - plan.motion.averaged) * plan.description.controller_step
        if plan.motion.settles or waits >= found.delay:
            return []
        return [
            f"The specimen is read {1e3 * waits:.0f} ms after its ramp has ended, and follows {1e3 * found.delay:.1f} ms late. "
            "Choose a larger time scale."
        ]
    if plan.compensation is None and found.delay == 0.0:
        return []
    growing = whole.growing_oscillations(partial(_loop_factor, plan, delay=found.delay))
    if not growing:
        return []
    mode = int(np.argmin(found.damping))
    which = (
        f"mode {mode + 1} ({whole.frequencies[mode] / (2 * np.pi):.3g} Hz) has a damping of {100.0 * found.damping[mode]:.2f} % "
        "and would grow"
        if found.damping[mode] <= 0.0
        else f"{growing} oscillation{'s' if growing > 1 else ''} would grow"
    )
    return [
        f"With a delay of {1e3 * found.delay:.1f} ms {which}. Without compensation up to {1e3 * found.critical_delay:.1f} ms can "
        "be borne. Choose a larger time scale, or compensate the delay."
    ]


def _unstable(plan: Plan, virtual: VirtualMoves, stiffness: float) -> list[str]:
    """What is wrong with steps and splitting, a sentence each."""
    said = []
    joined, physical = plan.joined, plan.joined.physical.part
    step = physical.largest_frequency * joined.dt
    if joined.guesses_for_specimen and step > LARGEST_FINE_STEP:
        said.append(
            f"ω Δt of the fine specimen is {step:.2f}, at most {LARGEST_FINE_STEP:g} is allowed: its spurious damping grows with "
            f"the cube. Take Δt of {LARGEST_FINE_STEP / physical.largest_frequency:.2g} s or less, or the numerical part as the "
            "fine one, or GravouilCombescure."
        )
    if stiffness > 1.0 + TANGENT_ERROR:
        stiff = joined.of_parts(joined.numerical.part.softened(1.0), physical.softened(stiffness))
        if (radius := spectral_radius(stiff)) > 1.0 + ROUNDING:
            said.append(
                f"The specimen is expected to be {stiffness:.3g} times as stiff as K₀, with which a step of {joined.dt:g} s grows "
                f"by {radius:.3g}. K₀ must be its largest tangent; or take smaller steps."
            )
    if not virtual.bounded:
        said.append("In the virtual run displacements grow beyond all bounds: the steps are unstable.")
    if plan.motion.samples > plan.description.longest_path:
        said.append(
            f"A move has {plan.motion.samples} controller steps, and the specimen takes {plan.description.longest_path} at most. "
            "Choose a smaller time scale, or smaller steps."
        )
    return said


def _beyond_limits(plan: Plan, found: Feasibility) -> list[str]:
    """What is beyond the limits of the channels, a sentence each."""
    said = []
    for k, channel in enumerate(plan.description.channels):
        for what, unit, limit, value in (
            ("displacement", channel.unit, channel.stroke, found.stroke[k]),
            ("velocity", f"{channel.unit}/s", channel.velocity, found.velocity[k]),
            ("force", "N" if channel.unit == "m" else "N m", channel.force, found.force[k]),
        ):
            if limit is not None and not value <= limit:
                cure = " Choose a larger time scale." if what == "velocity" else " Choose a weaker record."
                said.append(
                    f"{channel.name}: a {what} of {value:.4g} {unit} is expected, and the limit is {limit:.4g}.{cure}"
                )
    return said


def _warnings(plan: Plan, found: Feasibility, stiffness: float) -> list[str]:
    """What one should know, a sentence each."""
    said = []
    if found.spurious_damping < -1e-6:
        said.append(
            f"A specimen that softens gets a spurious damping of down to {100.0 * found.spurious_damping:.2g} % from this coupling."
        )
    if stiffness > 1.0 + TANGENT_ERROR:
        said.append(
            f"The specimen has a stiffness of {stiffness:.3g} times the K₀ of its part. K₀ must be the largest tangent, or steps "
            "may be unstable."
        )
    if plan.compensation is None and plan.motion.continuous and found.delay > 0.5 * found.critical_delay:
        share = found.delay / found.critical_delay
        said.append(f"The delay is {100.0 * share:.0f} % of the critical one, and nothing compensates it.")
    return said
