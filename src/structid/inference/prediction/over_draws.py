"""Quantiles over draws of a history, in blocks of samples: NumPy would copy all draws once more."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Float

VALUES_AT_ONCE = 1_000_000
"""Approximate number of values in a block, 8 MB."""


def quantiles(
    draws: Float[np.ndarray, "draw time channel"], probabilities: Sequence[float]
) -> Float[np.ndarray, "probability time channel"]:
    """Quantiles of every sample."""
    return _by_samples(draws, lambda some: np.quantile(some, probabilities, axis=0), axis=1)


def median(draws: Float[np.ndarray, "draw time channel"]) -> Float[np.ndarray, "time channel"]:
    """Median of every sample."""
    return _by_samples(draws, lambda some: np.median(some, axis=0), axis=0)


def _by_samples(draws: np.ndarray, of_block: Callable[[np.ndarray], np.ndarray], axis: int) -> np.ndarray:
    """Join the results for some samples at a time; `axis` is the time in the results."""
    runs, samples, channels = draws.shape
    size = max(1, VALUES_AT_ONCE // max(runs * channels, 1))
    return np.concatenate(
        [of_block(draws[:, first : first + size]) for first in range(0, max(samples, 1), size)], axis=axis
    )
