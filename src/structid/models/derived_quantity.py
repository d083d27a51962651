"""Quantities derived from a model's parameters."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float


class DerivedQuantity(NamedTuple):
    """A quantity derived from the parameters of many runs."""

    values: Float[np.ndarray, " run"]  # values in SI
    unit: str  # display unit, such as ``"mm"``
