"""The linear limit of the oscillator against Duhamel's integral, with a figure and a verdict.

With no hysteresis (β = γ = 0, n = 100) the model is a linear oscillator, whose displacement is
u(t) = ∫ p(τ) h(t − τ) dτ with p = −m a_g and h = exp(−ζω t) sin(ω_d t)/(m ω_d).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

import structid as si
from structid.figures.style import ACCENT, MODEL, canvas, finish, name_axes, styled

MASS, STIFFNESS, DAMPING_RATIO = 12_000.0, 7.6e6, 0.03


def duhamel(record: si.GroundMotion, refinement: int = 20) -> np.ndarray:
    """Displacement [m] at the record's samples by the trapezoidal rule on a finer grid."""
    dt = record.dt / refinement
    time = np.arange((len(record) - 1) * refinement + 1) * dt
    force = -MASS * np.interp(time, record.time, record.values)
    omega = np.sqrt(STIFFNESS / MASS)
    damped = omega * np.sqrt(1.0 - DAMPING_RATIO**2)
    impulse = np.exp(-DAMPING_RATIO * omega * time) * np.sin(damped * time) / (MASS * damped)
    # Both ends of the trapezoidal rule: h(0) = 0, and p(0) weighs half.
    return ((np.convolve(force, impulse)[: time.size] - 0.5 * force[0] * impulse) * dt)[::refinement]


@styled
def draw(record: si.GroundMotion, model: np.ndarray, exact: np.ndarray, force: np.ndarray, save: Path) -> None:
    """Both displacements, and the restoring force against the displacement."""
    figure, axes = canvas(1, 2, height=2.6, gridspec_kw={"width_ratios": [2.0, 1.0]})
    axes[0, 0].plot(record.time, exact * 1e3, color=ACCENT, lw=2.2, alpha=0.5, label="Duhamel's integral")
    axes[0, 0].plot(record.time, model * 1e3, color=MODEL, lw=0.8, label="Bouc-Wen-Baber-Noori, linear limit")
    axes[0, 0].legend(loc="upper right")
    axes[0, 0].set_xlim(0.0, record.duration)
    name_axes(axes[0, 0], ("time", "s"), ("displacement", "mm"))
    axes[0, 1].plot(model * 1e3, force * 1e-3, color=MODEL, lw=0.8)
    name_axes(axes[0, 1], ("displacement", "mm"), ("restoring force", "kN"))
    finish(figure, save=save)


def main(save: Path = Path("linear_limit")) -> float:
    """Compare, draw, say the verdict, and return the relative difference."""
    record = si.GroundMotion.synthetic(seed=8).lowpass(20.0).scale_to_pga(3.59)
    model = si.BoucWen(
        mass=MASS,
        stiffness=STIFFNESS,
        damping_ratio=DAMPING_RATIO,
        alpha=0.3,
        beta=0.0,
        gamma=0.0,
        exponent=100.0,
        channels=("displacement", "restoring_force"),
    )
    displacement, force = model.simulate([[]], record).values[0].T
    exact = duhamel(record)
    difference = float(np.linalg.norm(displacement - exact) / np.linalg.norm(exact))
    draw(record, displacement, exact, force, save)
    print(f"relative difference {difference:.1e}: {'a match' if difference < 1e-3 else 'NO match'}")
    return difference


if __name__ == "__main__":
    main()
