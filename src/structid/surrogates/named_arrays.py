"""Names of the arrays of nested parts in files, such as ``0/scores/weights``."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np


def put_under(name: str, arrays: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Prefix the names of arrays with the name of their part."""
    return {f"{name}/{key}": array for key, array in arrays.items()}


def found_under(name: str, arrays: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Select the arrays of a part, without the prefix; the inverse of `put_under`."""
    return {key.removeprefix(f"{name}/"): array for key, array in arrays.items() if key.startswith(f"{name}/")}
