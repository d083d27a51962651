"""Study-file keys of Kriging, alone or inside another surrogate."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field

from structid.surrogates.chaos.pce import PCE

KRIGING_KEYS = {
    "correlation": Literal["exponential", "matern32", "matern52", "gaussian"],
    "separable": bool,
    "nugget": float | Literal["estimate"],
    "estimation": Literal["ml", "cv"],
    "trend": Literal["constant", "linear", "quadratic", "pce"],
    "starts": Annotated[int, Field(ge=1)],
    "shared": bool,
}
"""Keys and their types; see `Kriging`."""


def kriging_settings(given: dict[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Separate the keys of Kriging from other keys."""
    kriging_keys = {key: value for key, value in given.items() if key in KRIGING_KEYS}
    if kriging_keys.get("trend") == "pce":
        kriging_keys["trend"] = PCE()
    return kriging_keys, {key: value for key, value in given.items() if key not in KRIGING_KEYS}
