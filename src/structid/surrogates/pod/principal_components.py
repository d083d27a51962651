"""Principal components of histories (proper orthogonal decomposition)."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from structid.core.errors import InputError


def check_energy(left_out: float) -> None:
    """Refuse a number that is not a valid fraction of the variance."""
    if not 0 <= left_out < 1:
        raise InputError("left_out_energy", f"{left_out}", "a fraction of at least 0 and below 1")


def principal_components(
    table: Float[np.ndarray, "run sample"], left_out_energy: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Compute a proper orthogonal decomposition by singular value decomposition of the centred table."""
    check_energy(left_out_energy)
    mean = table.mean(axis=0)
    left, singular, right = np.linalg.svd(table - mean, full_matrices=False)
    energy = singular**2
    beyond = energy.sum() - np.cumsum(energy)
    # Components below the rounding error contain no information.
    kept = 1 + int(np.count_nonzero(beyond > max(left_out_energy, 1e-14) * energy.sum()))
    kept = min(kept, len(table) - 2)
    rest = (left[:, kept:] * singular[kept:]) @ right[kept:]
    return mean, right[:kept], left[:, :kept] * singular[:kept], np.sqrt(np.mean(rest**2, axis=0))
