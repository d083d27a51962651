"""Arrays of parts within parts, by names such as ``0/scores/weights``, as files keep them."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np


def put_under(name: str, arrays: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Name a part's arrays below the part.

    Parameters
    ----------
    name : str
        The part.
    arrays : mapping of str to ndarray
        Its arrays.

    Returns
    -------
    dict of str to ndarray
        ``name/…``.
    """
    return {f"{name}/{key}": array for key, array in arrays.items()}


def found_under(name: str, arrays: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Pick a part's arrays by their own names; the inverse of `put_under`.

    Parameters
    ----------
    name : str
        The part.
    arrays : mapping of str to ndarray
        Those of all parts.

    Returns
    -------
    dict of str to ndarray
        Those of this one.
    """
    return {key.removeprefix(f"{name}/"): array for key, array in arrays.items() if key.startswith(f"{name}/")}
