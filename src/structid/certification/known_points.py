"""Points at which the true posterior is known."""

from __future__ import annotations

import numpy as np

Points = tuple[np.ndarray, np.ndarray]
"""Points (point, parameter) in SI, and log π there."""


def joined(first: Points, then: Points) -> Points:
    """Put points behind others."""
    return np.concatenate([first[0], then[0]]), np.concatenate([first[1], then[1]])
