"""Paths of deformations, and the force of a hysteretic law along them."""

import numpy as np

from structid.mechanics.hysteretic_laws.base import HystereticLaw
from structid.mechanics.hysteretic_laws.law_list import LAWS

TYPICAL = {word: law.example for word, law in LAWS.items()}
"""Typical values of every law's parameters, for deformations of the order of 1."""

CYCLES = np.array([0.2, -0.2, 0.4, -0.4, 0.7, -0.7, 0.3, -0.2, 1.0, -1.0, 1.0, -1.0])
"""Turning points of a cyclic test with an inner cycle."""


def random_values(law: type[HystereticLaw], runs: int, without: str = "nothing") -> dict[str, np.ndarray]:
    """Draw parameters of many springs from the default priors, for a stiffness of about 10, deformations and forces of about 1."""
    rng = np.random.default_rng(1)
    scale = {"N/m": 10.0, "N": 1.0, "m": 1.0, "": 1.0}
    described = {n: p for n, p in law.parameters().items() if p.prior is not None}
    values = {n: p.prior.quantile(rng.random(runs)) * scale[p.unit] for n, p in described.items()}
    return {name: value for name, value in values.items() if not name.endswith(without)}


def random_ends(runs: int, count: int = 30) -> np.ndarray:
    """Turning points (turn, run) that grow, with inner cycles."""
    return np.random.default_rng(2).normal(size=(count, runs)) * 0.6 * np.linspace(0.2, 1.5, count)[:, None]


def path_between(ends: np.ndarray, pieces: int) -> np.ndarray:
    """Deformations from zero over the turning points, each move in equal pieces."""
    starts = np.concatenate([0.0 * ends[:1], ends[:-1]])
    return np.concatenate([np.linspace(a, b, pieces + 1)[1:] for a, b in zip(starts, ends, strict=True)])


def forces_along(law: HystereticLaw, path: np.ndarray) -> np.ndarray:
    """Force of one spring, or of one for each run, at every deformation of a path (time,) or (time, run)."""
    return law.forces_along(path)


def typical(word: str, **changes: float) -> HystereticLaw:
    """A law with its typical values."""
    return LAWS[word]().with_values(TYPICAL[word] | changes)
