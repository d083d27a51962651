"""Critical delays of a hybrid test: closed forms for one degree of freedom, and a numerical solution for any structure.

A delayed specimen returns its force late, which feeds energy into the structure. The critical delay is the shortest delay at which
a free oscillation no longer decays. If the specimen is rate-independent, a delay of τ in wall time acts as a delay of τ/λ in
simulated time.

Source: T. Horiuchi, M. Inoue, T. Konno & Y. Namita (1999, Earthq. Eng. Struct. Dyn. 28, 1121) for the delay as negative damping.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy
from jaxtyping import Float

from structid.core.errors import InputError
from structid.core.validation import check_arguments

GRID = 4000
"""Number of frequencies in the initial grid, before roots between them are refined."""
HIGHEST = 3.0
"""Highest frequency examined, relative to the highest natural frequency."""
INERTIA_ALONE = 30.0
"""Frequency, relative to the highest natural frequency, above which inertia alone determines the determinant."""
SMALL_TURN = 0.5
"""Largest change of the determinant's argument between two frequencies [rad] before the step is halved."""
REFINEMENTS = 40
"""Largest number of halvings of a step; if they do not suffice, a root lies on the imaginary axis."""


@dataclass(frozen=True)
class CriticalDelay:
    """The shortest delay at which a free oscillation no longer decays."""

    delay: float  # τ_c in simulated time [s]; infinite if no delay is critical
    frequency: float  # Ω of this oscillation [rad/s]; NaN if no delay is critical

    def on_the_wall(self, time_scale: float) -> float:
        """Critical delay in wall time [s]."""
        return time_scale * self.delay


@check_arguments
def critical_delay(frequency: float, damping_ratio: float, share: float = 1.0) -> CriticalDelay:
    """Return the critical delay of a structure with one degree of freedom.

    With p the specimen's fraction of the stiffness and x = Ω/ω::

    (x² − 1 + p)² + 4ζ²x² = p²,    tan(Ω τ_c) = 2ζx / (x² − 1 + p),    τ_c ≈ 2ζ/(p ω)
    """
    if not frequency > 0.0 or damping_ratio < 0.0 or not 0.0 < share <= 1.0:
        came = f"ω = {frequency:g} rad/s, ζ = {damping_ratio:g}, p = {share:g}"
        raise InputError("critical_delay", came, "ω > 0, ζ ≥ 0 and 0 < p ≤ 1")
    # x⁴ + 2 b x² + c = 0 with b = 2ζ² − 1 + p and c = 1 − 2p; the oscillation at the larger root loses its damping first.
    b, c = 2.0 * damping_ratio**2 - 1.0 + share, 1.0 - 2.0 * share
    inner = b * b - c
    square = -b + np.sqrt(inner) if inner >= 0.0 else -1.0
    if square <= 0.0:
        return CriticalDelay(np.inf, np.nan)
    x = float(np.sqrt(square))
    angle = np.arctan2(2.0 * damping_ratio * x, square - 1.0 + share)
    return CriticalDelay(float(angle / (x * frequency)), float(x * frequency))


@check_arguments
def critical_lag(frequency: float, damping_ratio: float) -> float:
    """Return the critical time constant of a first-order lag, (2ζ/ω)/(1 − 4ζ²), if all stiffness is the specimen's."""
    left = 1.0 - 4.0 * damping_ratio**2
    return 2.0 * damping_ratio / frequency / left if left > 0.0 else np.inf


@check_arguments
def critical_delay_of(
    mass: Float[np.ndarray, "dof dof"],
    damping: Float[np.ndarray, "dof dof"],
    numerical: Float[np.ndarray, "dof dof"],
    physical: Float[np.ndarray, "dof dof"],
) -> CriticalDelay:
    """Critical delay of a whole structure: the smallest τ > 0 with det(−Ω²M + iΩC + K_N + K_P e^(−iΩτ)) = 0 for some Ω.

    At each Ω the eigenvalues μ of (−Ω²M + iΩC + K_N)⁻¹ K_P give e^(−iΩτ) = −1/μ; a real delay τ requires |μ| = 1.
    """
    squares = scipy.linalg.eigh(numerical + physical, mass, eigvals_only=True)
    grid = np.linspace(0.0, HIGHEST * np.sqrt(squares.max()), GRID + 1)[1:]

    def ratios(omega: np.ndarray) -> np.ndarray:
        """Return the eigenvalues μ at each Ω, the largest magnitude first, shape (frequency, dof)."""
        w = omega[:, None, None]
        dynamic = -(w**2) * mass + 1j * w * damping + numerical
        values = np.linalg.eigvals(np.linalg.solve(dynamic, np.broadcast_to(physical, dynamic.shape).astype(complex)))
        return np.take_along_axis(values, np.argsort(-np.abs(values), axis=1), axis=1)

    def over(omega: float, order: int) -> float:
        return float(np.abs(ratios(np.array([omega]))[0, order]) - 1.0)

    sizes = np.abs(ratios(grid)) - 1.0
    critical = CriticalDelay(np.inf, np.nan)
    for step, order in np.argwhere(sizes[:-1] * sizes[1:] < 0.0):
        omega = float(scipy.optimize.brentq(over, grid[step], grid[step + 1], args=(order,), xtol=1e-13))
        turn = -1.0 / ratios(np.array([omega]))[0, order]  # e^(−iΩτ)
        delay = float(-np.angle(turn) % (2.0 * np.pi) / omega)
        if 0.0 < delay < critical.delay:
            critical = CriticalDelay(delay, omega)
    return critical


def growing_oscillations(
    mass: Float[np.ndarray, "dof dof"],
    damping: Float[np.ndarray, "dof dof"],
    numerical: Float[np.ndarray, "dof dof"],
    physical: Float[np.ndarray, "dof dof"],
    factor: Callable[[float], complex],
) -> int:
    """Count the growing oscillations of a structure whose specimen force is delayed.

    Mikhailov's criterion (A. V. Mikhailov 1938, Avtomatika i Telemekhanika 3, 27) also holds with delays, if inertia forces are not
    delayed. While Ω increases from 0 to ∞, the argument of det(−Ω²M + iΩC + K_N + G(Ω) K_P) turns by (n − N) π. Here n is the
    number of degrees of freedom, and N the number of growing roots, two for each oscillation.
    """
    highest = np.sqrt(scipy.linalg.eigh(numerical + physical, mass, eigvals_only=True).max())
    most = np.abs(scipy.linalg.eigh(damping, mass, eigvals_only=True)).max()

    def directions(omega: np.ndarray) -> np.ndarray:
        """The determinant divided by its magnitude."""
        w, late = omega[:, None, None], np.array([factor(o) for o in omega])[:, None, None]
        return np.asarray(np.linalg.slogdet(-(w**2) * mass + 1j * w * damping + numerical + late * physical)[0])

    grid = np.linspace(0.0, INERTIA_ALONE * max(highest, most), GRID + 1)
    values = directions(grid)
    for _ in range(REFINEMENTS):
        wide = np.flatnonzero(np.abs(np.angle(values[1:] / values[:-1])) > SMALL_TURN)
        if not len(wide):
            break
        between = 0.5 * (grid[wide] + grid[wide + 1])
        grid, values = np.insert(grid, wide + 1, between), np.insert(values, wide + 1, directions(between))
    turn = float(np.angle(values[1:] / values[:-1]).sum())
    return max(round((len(mass) - turn / np.pi) / 2.0), 0)
