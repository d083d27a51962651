"""The evidence from the proposals of independence moves, which cost no evaluations of their own.

A proposal x from a density q has the weight w = π(x)/q(x), whose mean is the evidence Z, whatever the tempering steps before. If a
narrow mode becomes dominant within a wide one, too few particles lie on it in the earlier steps, and their evidence is too small.
The particles at β = 1 lie on it, and so do the proposals that are fitted to them.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy.special import logsumexp

from structid.inference.sampling.base import Evidence

UPPER = (0.5, 0.1)
"""Fractions of the particles of highest density, whose share in the weights is compared with these numbers."""
COLUMNS = 4 + len(UPPER)
"""Number of proposals, log Σw, log Σw², the largest log w, and log Σw over proposals denser than each fraction of `UPPER`."""
LEAST_SIZE = 2000.0
"""Smallest effective number of proposals, (Σw)²/Σw², for an evidence."""
LARGEST_SHARE = 0.02
"""Largest share of one proposal in all weights for an evidence: rare large weights are missing in most samples."""
LARGEST_GAP = 0.05
"""Largest difference between a share in the weights and the same share of the particles for an evidence."""

NOTHING = np.array([0.0, *np.full(COLUMNS - 1, -np.inf)])
"""Sums over no proposals."""


def sums_of_weights(
    log_weight: Float[np.ndarray, "ensemble proposal"],
    log_density: Float[np.ndarray, "ensemble proposal"],
    particles: Float[np.ndarray, "ensemble particle"],
) -> Float[np.ndarray, "ensemble column"]:
    """Sums over the proposals of one move, with the log densities of the proposals and of the particles; see `COLUMNS`."""
    levels = np.quantile(particles, [1.0 - fraction for fraction in UPPER], axis=1)
    denser = [np.where(log_density > level[:, None], log_weight, -np.inf) for level in levels]
    return np.stack(
        [
            np.full(len(log_weight), float(log_weight.shape[1])),
            logsumexp(log_weight, axis=1),
            logsumexp(2.0 * log_weight, axis=1),
            log_weight.max(axis=1),
            *(logsumexp(each, axis=1) for each in denser),
        ],
        axis=1,
    )


def together(sums: Float[np.ndarray, "*of ensemble column"]) -> Float[np.ndarray, "ensemble column"]:
    """Add up the sums over several moves, which are the first axis."""
    added = logsumexp(sums, axis=0)
    added[:, 0], added[:, 3] = sums[..., 0].sum(axis=0), sums[..., 3].max(axis=0)
    return np.asarray(added)


def evidence_of_proposals(sums: Float[np.ndarray, "step ensemble column"]) -> Evidence | None:
    """Evidence from all proposals at β = 1; None if they are too few, or do not cover the particles.

    Its error contains the difference between the shares of the densest points in the weights and among the particles: a mode that
    the proposals hardly reach is missing in both.
    """
    each = together(sums)
    count, weights, squares, largest = each[:, :4].T
    if not (count.all() and np.isfinite(weights).all()):
        return None
    size = float(np.exp(2.0 * logsumexp(weights) - logsumexp(squares)))
    share = float(np.exp(largest.max() - logsumexp(weights)))
    gap = max(
        abs(float(np.exp(logsumexp(each[:, 4 + k]) - logsumexp(weights))) - fraction)
        for k, fraction in enumerate(UPPER)
    )
    if size < LEAST_SIZE or share > LARGEST_SHARE or gap > LARGEST_GAP:
        return None
    # Var w / (N w̄²) = Σw²/(Σw)² − 1/N
    variance = np.maximum(np.exp(squares - 2.0 * weights) - 1.0 / count, 0.0)
    return Evidence.of_populations(weights - np.log(count), variance, np.full(len(each), gap))
