"""Difference of two densities, from draws of one of them."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from structid.certification.correction import Correction
from structid.certification.fresh_draws import DensityDifference

FOLDS = 10
"""Number of folds of the draws; each fold is left out in turn."""


def density_difference(
    gap: Float[np.ndarray, " draw"], draws: Float[np.ndarray, "draw parameter"]
) -> tuple[float, DensityDifference]:
    """Compare a density p with q, from draws of q."""
    scale = float(np.log(np.mean(np.exp(gap - gap.max()))) + gap.max())
    weights = np.exp(gap - scale)
    correction = Correction.between(draws, np.ones(len(draws)), weights)
    return scale, DensityDifference(float(np.std(weights)), np.abs(correction.mean), np.abs(correction.sd - 1.0))
