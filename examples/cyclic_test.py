"""Fit a quasi-static cyclic test of a masonry wall: the displacement is imposed and the force is fitted.

Data: force-displacement histories of stone-masonry walls (StoneMasonryDatabase, MIT licence), not part of this package.

    python examples/cyclic_test.py PATH/FD_PG1_Almeida2012.csv
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

import structid as si
from structid.figures import loops

DEFAULT = Path(__file__).parents[2] / "shared" / "data" / "hysteresis" / "FD_PG1_Almeida2012.csv"


def read(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Top displacement [m] and horizontal force [N]."""
    table = np.genfromtxt(path, delimiter=",", skip_header=4, usecols=(0, 1))
    table = table[np.isfinite(table).all(axis=1)]
    return table[:, 0] * 1e-3, table[:, 1] * 1e3


def fit(
    displacement: np.ndarray, force: np.ndarray, starts: int = 12
) -> tuple[si.Posterior, si.optimize.OptimizeResult]:
    """Identify stiffness, hardening, shape, degradation and pinching by interior point from several starts."""
    peak_u, peak_f = np.abs(displacement).max(), np.abs(force).max()
    secant = peak_f / peak_u
    scale = peak_u / 3  # the displacement at which the spring is well beyond yielding
    space = si.ParameterSpace(
        stiffness=si.Uniform(0.5 * secant, 30 * secant, unit="N/m"),
        alpha=si.Uniform(0.0, 0.3),
        beta=si.Uniform(0.2 / scale, 10 / scale, unit="1/m"),
        gamma_ratio=si.Uniform(-1.0, 1.0),
        delta_nu=si.Uniform(0.0, 3.0 / (peak_f * peak_u), unit="kg/J"),
        delta_eta=si.Uniform(0.0, 3.0 / (peak_f * peak_u), unit="kg/J"),
        initial_hysteretic_displacement=si.Uniform(-0.05 * peak_u, 0.05 * peak_u, unit="m"),
    )
    # A step may be one and a half lengths on which the hysteretic force changes: 1.5 / (β + |γ|), for the stiffest spring allowed.
    longest = np.abs(np.diff(displacement)).max()
    substeps = int(np.ceil(longest * 2.0 * space.bounds[space.names.index("beta"), 1] / 1.5))
    model = si.BoucWen(mass=1.0, free=space.names, channels=("restoring_force",), substeps=substeps)
    path = si.DisplacementHistory(displacement, 1.0, "cyclic test")
    posterior = si.Posterior(space, model, si.Observation(path, force, ("restoring_force",)))
    return posterior, si.optimize.interior_point(posterior.misfit, starts=starts, seed=1, iterations=150)


def main(path: Path = DEFAULT, save: Path | None = Path("cyclic_test")) -> float:
    """Fit, draw, and return the unexplained fraction of the force's variance."""
    displacement, force = read(path)
    posterior, result = fit(displacement, force)
    best = np.append(result.best.theta, 1.0)
    predicted = posterior.predict(best[None])[0, :, 0]
    unexplained = float(np.sum((force - predicted) ** 2) / np.sum((force - force.mean()) ** 2))
    if save is not None:
        u = displacement * 1e3
        title = f"{path.stem}: {unexplained:.1%} of the force's variance unexplained"
        samples = np.arange(len(u), dtype=float)
        loops.loops(
            samples, (u, force * 1e-3), (u, predicted * 1e-3), title, save, names=("test", "Bouc-Wen-Baber-Noori")
        )
    print(result)
    print(f"unexplained: {unexplained:.3%}")
    return unexplained


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:2]))
