"""Feasibility of a hybrid test before any movement: key figures, refusals and warnings."""

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
"""Largest ω_P Δt of a fine specimen under predicted interface forces; above it, spurious damping is no longer small."""
ROUNDING = 1e-6
"""Tolerance for a stiffness ratio or an amplification that should be at most one."""
ABSURD = 1e3
"""Displacement that no specimen can reach [m]."""
TANGENT_ERROR = 1e-4
"""Error of a stiffness from finite differences, relative to K₀."""
PROBE = 1e-7
"""Displacement of the finite differences that give the initial tangent stiffness of the expected force [m]."""
SOFTENED = (1.0, 0.5, 0.3, 0.1, 0.03)
"""Fractions of K₀ at which the damping of a softened specimen is examined."""


@dataclass(frozen=True)
class Feasibility:
    """Key figures, refusals and warnings of a test, computed before it starts."""

    critical_delay: float  # λ τ_c [s] of wall time; infinite if no delay is critical
    delay: float  # delay of the transfer system, as declared by the specimen [s]
    damping: tuple[float, ...]  # damping ratio of each mode, with the delay and its compensation
    # Smallest damping ratio that the coupling adds to a mode of a softened specimen; usually negative
    spurious_damping: float
    stroke: tuple[float, ...]  # largest displacement of every channel in a virtual run [m]
    velocity: tuple[float, ...]  # largest velocity of every channel in a virtual run [m/s] of wall time
    force: tuple[float, ...]  # largest force of every channel in a virtual run [N]
    wall_time: float  # expected duration of the test [s]
    steps: int  # number of coarse steps
    refusals: tuple[str, ...] = ()  # reasons why the test is infeasible
    warnings: tuple[str, ...] = ()  # warnings about a feasible test

    @property
    def can_work(self) -> bool:
        """True if there is no refusal."""
        return not self.refusals

    def __str__(self) -> str:
        lines = [
            "This test is feasible." if self.can_work else "This test is not feasible.",
            *(f"  - {refusal}" for refusal in self.refusals),
            *(f"  note: {warning}" for warning in self.warnings),
            f"critical delay      {1e3 * self.critical_delay:.1f} ms of wall time",
            f"delay               {1e3 * self.delay:.1f} ms of the transfer system",
            f"damping with delay  {', '.join(f'{100.0 * z:.2f}' for z in self.damping)} %",
            f"spurious damping    {100.0 * self.spurious_damping:.2g} % at the worst softening",
            f"expected stroke     {', '.join(f'{1e3 * x:.2f}' for x in self.stroke)} mm",
            f"expected velocity   {', '.join(f'{1e3 * x:.2f}' for x in self.velocity)} mm/s of wall time",
            f"expected force      {', '.join(f'{1e-3 * x:.1f}' for x in self.force)} kN",
            f"duration            {self.steps} steps, {self.wall_time:.0f} s of wall time",
        ]
        return "\n".join(lines)


@dataclass(frozen=True, eq=False)
class HybridTestPlan:
    """A planned test, the input to the feasibility check."""

    joined: Joined  # both parts, with the expected force of the physical part
    description: SpecimenDescription  # description of the specimen
    geometry: Float[np.ndarray, "channel dof"]  # B
    motion: Motion  # motion of the specimen
    compensation: Compensation | None  # compensation of the transfer system
    time_scale: float  # λ


@dataclass(frozen=True, eq=False)
class VirtualMoves:
    """Moves of the specimen in a virtual run with the expected force."""

    targets: Float[np.ndarray, "move channel"]  # displacements [m]
    forces: Float[np.ndarray, "move channel"]  # forces [N]
    collapse: str = ""  # reason of a failure; empty if the run did not fail

    @property
    def bounded(self) -> bool:
        """True if all values are finite and no displacement reaches `ABSURD`."""
        return bool(np.abs(self.targets).max() < ABSURD and np.isfinite(self.forces).all())


def commanded(plan: HybridTestPlan, targets: Float[np.ndarray, "move channel"]) -> tuple[np.ndarray, np.ndarray]:
    """Return the largest displacement and rate of the commands, which compensation can increase."""
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


def damping_with_delay(plan: HybridTestPlan, whole: WholeStructure, delay: float) -> Float[np.ndarray, " mode"]:
    """Return the damping ratio of each mode: ζ + p Im G/2 with G = gain · e^(−iωτ)."""
    if not plan.motion.continuous:
        return whole.damping_ratios
    factors = np.array([_loop_factor(plan, omega, delay) for omega in whole.frequencies])
    return np.asarray(whole.damping_ratios + 0.5 * whole.shares * factors.imag)


def _loop_factor(plan: HybridTestPlan, omega: float, delay: float) -> complex:
    """Return the factor G = gain · e^(−iωτ) of the specimen's force, for a frequency in simulated time."""
    turned = omega / plan.time_scale
    gain = 1.0 if plan.compensation is None else plan.compensation.gain(turned, delay)
    return complex(gain * np.exp(-1j * turned * delay))


def spurious_damping(plan: HybridTestPlan) -> float:
    """Return the lowest damping ratio of undamped parts with a softened specimen, which the coupling alone causes."""
    numerical, physical = (side.part for side in (plan.joined.numerical, plan.joined.physical))
    dampings = [
        free_oscillations(plan.joined.of_parts(numerical.undamped().softened(1.0), physical.undamped().softened(share)))
        for share in SOFTENED
    ]
    return min(float(f.damping_ratios.min(initial=0.0)) for f in dampings)


def check_feasibility(plan: HybridTestPlan, virtual: VirtualMoves, steps: int) -> Feasibility:
    """Check the feasibility of a test with the moves of a virtual run."""
    whole = WholeStructure.of(plan.joined)
    delay = max(channel.delay for channel in plan.description.channels)
    with np.errstate(over="ignore", invalid="ignore"):
        stroke, velocity = commanded(plan, virtual.targets)
    feasibility = Feasibility(
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
    refusals = (
        *_late(plan, whole, feasibility),
        *_unstable(plan, virtual, stiffness),
        *_beyond_limits(plan, feasibility),
    )
    return replace(
        feasibility,
        refusals=refusals,
        warnings=(*_warnings(plan, feasibility, stiffness), *filter(None, [virtual.collapse])),
    )


def largest_stiffness(plan: HybridTestPlan, virtual: VirtualMoves) -> float:
    """Return the largest declared or expected stiffness of the specimen, relative to K₀."""
    stiffness, back = plan.joined.physical.part.stiffness, np.linalg.pinv(plan.geometry)
    ratios = [
        1.0,
        float(scipy.linalg.eigh(_first_tangent(plan.joined.physical.part), stiffness, eigvals_only=True).max()),
    ]
    if plan.description.stiffness is not None:
        declared = plan.geometry.T @ np.array(plan.description.stiffness) @ plan.geometry
        ratios.append(float(scipy.linalg.eigh(declared, stiffness, eigvals_only=True).max()))
    if virtual.bounded:
        secant = largest_secant(virtual.targets, virtual.targets, virtual.forces, back.T @ stiffness @ back)
        ratios += [secant] if secant > STIFFER else []
    return max(ratios)


def _first_tangent(part: Substructure) -> np.ndarray:
    """Return the initial tangent stiffness of the expected force, from small displacements."""
    start = np.zeros(part.dofs)
    at_rest, memory = part.force.begin(start)
    columns = [(part.force.at(memory, PROBE * row)[0] - at_rest) / PROBE for row in np.eye(part.dofs)]
    tangent = np.column_stack(columns)
    return np.asarray(0.5 * (tangent + tangent.T))


def _late(plan: HybridTestPlan, whole: WholeStructure, figures: Feasibility) -> list[str]:
    """Return messages that refuse a test because of its delay."""
    if not plan.motion.continuous:
        waits = (plan.motion.samples - plan.motion.ramp - plan.motion.averaged) * plan.description.controller_step
        if plan.motion.settles or waits >= figures.delay:
            return []
        return [
            f"The specimen is read {1e3 * waits:.0f} ms after the end of its ramp, but its delay is {1e3 * figures.delay:.1f} ms. "
            "Choose a larger time scale."
        ]
    if plan.compensation is None and figures.delay == 0.0:
        return []
    growing = whole.growing_oscillations(partial(_loop_factor, plan, delay=figures.delay))
    if not growing:
        return []
    mode = int(np.argmin(figures.damping))
    which = (
        f"mode {mode + 1} ({whole.frequencies[mode] / (2 * np.pi):.3g} Hz) has a damping ratio of "
        f"{100.0 * figures.damping[mode]:.2f} % and would grow"
        if figures.damping[mode] <= 0.0
        else f"{growing} oscillation{'s' if growing > 1 else ''} would grow"
    )
    return [
        f"With a delay of {1e3 * figures.delay:.1f} ms, {which}. The critical delay without compensation is "
        f"{1e3 * figures.critical_delay:.1f} ms. Choose a larger time scale, or compensate the delay."
    ]


def _unstable(plan: HybridTestPlan, virtual: VirtualMoves, stiffness: float) -> list[str]:
    """Return messages that refuse a test because of its time steps or too stiff a specimen."""
    sentences = []
    coupled, physical = plan.joined, plan.joined.physical.part
    step = physical.largest_frequency * coupled.dt
    if coupled.guesses_for_specimen and step > LARGEST_FINE_STEP:
        sentences.append(
            f"ω Δt of the fine specimen is {step:.2f}. It must be at most {LARGEST_FINE_STEP:g}, because spurious "
            f"damping grows with (ω Δt)³. Use Δt of {LARGEST_FINE_STEP / physical.largest_frequency:.2g} s or less, "
            "make the numerical part the fine part, or use GravouilCombescure."
        )
    if stiffness > 1.0 + TANGENT_ERROR:
        stiff = coupled.of_parts(coupled.numerical.part.softened(1.0), physical.softened(stiffness))
        if (radius := spectral_radius(stiff)) > 1.0 + ROUNDING:
            sentences.append(
                f"The specimen is expected to be {stiffness:.3g} times as stiff as K₀. The response then grows by a factor of "
                f"{radius:.3g} in a step of {coupled.dt:g} s. Set K₀ to its largest tangent stiffness, or choose smaller steps."
            )
    if not virtual.bounded:
        sentences.append("In the virtual run, displacements grow without bound: the steps are unstable.")
    if plan.motion.samples > plan.description.longest_path:
        sentences.append(
            f"A move has {plan.motion.samples} controller steps, but the specimen accepts at most {plan.description.longest_path}. "
            "Choose a smaller time scale or smaller steps."
        )
    return sentences


def _beyond_limits(plan: HybridTestPlan, figures: Feasibility) -> list[str]:
    """Return messages that refuse a test because a channel exceeds a limit."""
    sentences = []
    for k, channel in enumerate(plan.description.channels):
        for what, unit, limit, value in (
            ("displacement", channel.unit, channel.stroke, figures.stroke[k]),
            ("velocity", f"{channel.unit}/s", channel.velocity, figures.velocity[k]),
            ("force", "N" if channel.unit == "m" else "N m", channel.force, figures.force[k]),
        ):
            if limit is not None and not value <= limit:
                cure = " Choose a larger time scale." if what == "velocity" else " Choose a weaker record."
                sentences.append(
                    f"{channel.name}: the expected {what} of {value:.4g} {unit} exceeds the limit of {limit:.4g}.{cure}"
                )
    return sentences


def _warnings(plan: HybridTestPlan, figures: Feasibility, stiffness: float) -> list[str]:
    """Messages that warn about a test."""
    sentences = []
    if figures.spurious_damping < -1e-6:
        sentences.append(
            f"If the specimen softens, this coupling changes damping ratios by up to {100.0 * figures.spurious_damping:.2g} %."
        )
    if stiffness > 1.0 + TANGENT_ERROR:
        sentences.append(
            f"The stiffness of the specimen is {stiffness:.3g} times the K₀ of its part. K₀ must be the largest "
            "tangent stiffness; otherwise steps may be unstable."
        )
    if plan.compensation is None and plan.motion.continuous and figures.delay > 0.5 * figures.critical_delay:
        share = figures.delay / figures.critical_delay
        sentences.append(f"The delay is {100.0 * share:.0f} % of the critical delay, and it is not compensated.")
    return sentences
