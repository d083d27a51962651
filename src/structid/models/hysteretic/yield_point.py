"""Yield point of a hysteretic spring, from stiffness, β, γ and n."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np


def yield_point(values: Mapping[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    """Return the yield point of a spring's first loading, where the lines of initial and final stiffness meet.

    u_y = z_u/A₀,   z_u = [A₀/(β+γ)]^(1/n)                             [3.10, without degradation]
    F_y = [α + (1−α) A₀] k_i u_y
    """
    alpha, amplitude = values["alpha"], values["amplitude"]
    both = np.asarray(values["beta"] + values["gamma"], dtype=np.float64)
    yielding = both > 0.0
    strength = np.where(yielding, amplitude / np.where(yielding, both, 1.0), np.inf) ** (1.0 / values["exponent"])
    displacement = strength / amplitude
    return displacement, (alpha + (1.0 - alpha) * amplitude) * values["stiffness"] * displacement
