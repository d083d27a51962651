"""What follows from a model's parameters."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float


class DerivedQuantity(NamedTuple):
    """One quantity that follows from a model's parameters, of many runs."""

    values: Float[np.ndarray, " run"]  # In SI
    unit: str  # In which it is shown, such as ``"mm"``
