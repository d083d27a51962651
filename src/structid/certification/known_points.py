"""Points with known true log density."""

from __future__ import annotations

import numpy as np

Points = tuple[np.ndarray, np.ndarray]
"""Points (point, parameter) in SI, and log π there."""


def joined(first: Points, then: Points) -> Points:
    """Append points to other points."""
    return np.concatenate([first[0], then[0]]), np.concatenate([first[1], then[1]])
