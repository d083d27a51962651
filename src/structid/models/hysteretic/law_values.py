"""Values and priors of models with a hysteretic law."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from structid.core.errors import InputError
from structid.core.units import factor_of
from structid.mechanics.hysteretic_laws.base import LawParameter
from structid.mechanics.hysteretic_laws.default_priors import around, near_zero, up_to
from structid.mechanics.hysteretic_laws.law_list import LAWS
from structid.models.hysteretic.prior_checks import DRAWS, TOLERATED
from structid.probability.space import ParameterSpace

MODEL_PARAMETERS: dict[str, LawParameter] = {
    "mass": LawParameter("mass m", "kg", 0.0, np.inf, around(1.0, 1.2), None, None),
    "damping_ratio": LawParameter("damping ratio ζ", "", 0.0, 1.0, up_to(0.1, high=1.0), None, 0.0),
    "damping": LawParameter("damping coefficient c", "N*s/m", 0.0, np.inf, around(1.0, 3.0), None, 0.0),
    "force_offset": LawParameter("force offset F₀", "N", -np.inf, np.inf, near_zero(0.2), 0.0, 0.0),
}
"""Parameters that a model has beside those of its law."""

PARAMETER_UNITS: dict[str, str] = {
    name: described.unit for law in LAWS.values() for name, described in (law.parameters() | MODEL_PARAMETERS).items()
}
"""SI unit of every parameter of every law; a name has the same unit in all laws."""


def check_law_value(where: str, name: str, value: float, described: LawParameter) -> None:
    """Refuse an impossible value; stiffnesses, strengths and masses must be positive."""
    positive = described.neutral is None and described.unit in ("N/m", "N", "m", "kg") and described.low == 0.0
    if not (described.low <= value <= described.high) or (positive and value == 0.0):
        low = "a positive number" if positive else f"{described.low:g}"
        allowed = (
            low
            if np.isinf(described.high) and positive
            else (
                f"{described.low:g} to {described.high:g}"
                if np.isfinite(described.high)
                else f"{described.low:g} and above"
            )
        )
        raise InputError(where, f"{value:g}", allowed)


def check_law_priors(space: ParameterSpace, free: Sequence[str], described: Mapping[str, LawParameter]) -> None:
    """Refuse priors with another unit than the parameter's, or with too many impossible values."""
    for name in set(free) & set(space.names):
        if unit := space.marginals[name].unit:
            factor_of(unit, described[name].unit, f"unit of the prior of '{name}'")
    draws = np.asarray(space.sample(DRAWS, 0, "sobol").columns(free)).T
    for name, values in zip(free, draws, strict=True):
        low, high = described[name].low, described[name].high
        outside = float(np.mean((values < low) | (values > high)))
        if outside > TOLERATED:
            allowed = f"{low:g} to {high:g}" if np.isfinite(high) else f"{low:g} and above"
            raise InputError(
                f"the prior of '{name}'",
                f"{outside:.0%} of the prior lies outside {allowed}",
                f"a prior within {allowed}",
                "Bound the prior with low and high, and check its unit.",
            )
