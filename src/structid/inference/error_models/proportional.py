"""Errors that grow with the response."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Float

from structid.core.validation import check_arguments
from structid.inference.error_models.error_model_kind import SQUARED, ErrorModelKind
from structid.inference.error_models.uncorrelated import Density, Uncorrelated
from structid.probability.marginals import Uniform
from structid.probability.truncation import Marginal

LARGEST_SHARE = 1.0
"""Upper limit of the default prior of a proportional error, relative to the response."""


@check_arguments
@dataclass(frozen=True, eq=False)
class Proportional(Uncorrelated):
    """Independent normal errors of which a part is proportional to the response: r_t ~ N(0, σ² + c² M_t²).

    Such errors come from a gain that fluctuates, or from a sensor whose noise grows with its signal.

    Parameters
    ----------
    variance : float, Marginal or None
        σ² of the constant part, in the square of the channel's SI unit: a number if it is known, or a prior. If left out, its
        prior is U(0, max|y|²).
    share : float, Marginal or None
        c, the standard deviation of the proportional part relative to the response: a number or a prior. If left out, its prior
        is U(0, 1).

    Examples
    --------
    >>> import structid as si
    >>> si.Proportional(share=si.Uniform(0.0, 0.2)).describe()["kind"]
    'proportional'
    """

    variance: float | Marginal | None = None
    share: float | Marginal | None = None

    kind: ClassVar[str] = "proportional"
    depends_on_response: ClassVar[bool] = True

    @classmethod
    def _names(cls) -> tuple[str, ...]:
        return ("variance", "share")

    def _default_prior(self, name: str, dt: float, samples: int) -> Marginal:
        return Uniform(0.0, LARGEST_SHARE)

    def density(self, values: Mapping[str, Any], channels: tuple[str, ...], white: Any, numpy: Any) -> Density:
        """Normal log density with a variance that depends on the response."""
        constant, square = values["variance"] + white, values["share"] ** 2

        def log_density(residual: Any, response: Any) -> Any:
            variance = constant + square * response**2
            return -0.5 * (numpy.log(2.0 * np.pi * variance) + residual**2 / variance)

        return log_density

    def sd(self, values: Mapping[str, Any], channels: tuple[str, ...], response: Any, numpy: Any) -> Any:
        """√(σ² + c² M²)."""
        return numpy.sqrt(values["variance"] + values["share"] ** 2 * response**2)

    def draw(
        self,
        rng: np.random.Generator,
        shape: tuple[int, int, int],
        unknown: Mapping[str, np.ndarray],
        channels: tuple[str, ...],
        dt: float,
        response: Float[np.ndarray, "run time channel"] | None = None,
    ) -> Float[np.ndarray, "run time channel"]:
        """Draw normal errors of this size; see `Discrepancy.draw`."""
        values = self._of_draws(unknown, channels, shape[0])
        return np.asarray(rng.standard_normal(shape) * self.sd(values, channels, response, np))


PROPORTIONAL_KIND = ErrorModelKind(Proportional, "proportional", {"variance": SQUARED, "share": ""})
"""The description of proportional errors, by which a study file can name them."""
