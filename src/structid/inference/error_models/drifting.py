"""Errors inside the model: parameters that drift during the response, and noise added to it."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np

from structid.core.errors import InputError
from structid.core.units import factor
from structid.core.validation import check_arguments
from structid.inference.error_models.base import Discrepancy, ErrorModel
from structid.inference.error_models.error_model_kind import ErrorModelKind
from structid.inference.error_models.independent import IID, IID_KIND
from structid.inference.error_models.kernels import AR1_KIND, DAMPED_COSINE_KIND
from structid.models.base import Model
from structid.models.drifting_model import DriftingModel, drift_name, knot_names
from structid.probability.marginals import LogNormal, Normal
from structid.probability.space import ParameterSpace
from structid.probability.truncation import Marginal

SPANS = 5
"""Default number of intervals between knots in the first record."""

MOST_SPANS = 100
"""Largest number of intervals in the first record: each knot adds a sampled value for every drifting parameter."""

DRIFT_MEDIAN, DRIFT_LOG_SD = 0.1, np.log(10.0) / 1.96
"""Prior of a drift relative to the parameter's prior standard deviation: lognormal, 95 % between a hundredth and one."""


@check_arguments
@dataclass(frozen=True, eq=False)
class Drifting(ErrorModel):
    """y = M(θ + d∘b(t)) + ε: the parameters of a wrong model are not constant, but drift about their mean.

    b_j(t) is N(0, 1) at knots and linear between them. The standard deviations d_j have lognormal priors, 95 % of which lie
    between a hundredth and one prior standard deviation of θ_j. The response itself is computed with the drifting parameters,
    without a linearisation. θ_j are means over time. The spread of a parameter at any time is √(sd² + d_j²), which
    predictions of other records use.

    Parameters
    ----------
    every : float, optional
        Time between knots [s]; by default a fifth of the first record.
    errors : Discrepancy
        Error model of ε, which is added to the response.

    Examples
    --------
    >>> import structid as si
    >>> errors = si.Drifting(every=2.0, errors=si.AR1())
    >>> errors.describe()["every"]
    2.0
    """

    every: float | None = None
    errors: Discrepancy = field(default_factory=IID)
    _space: ParameterSpace | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        if self.every is not None and not (isinstance(self.every, (int, float)) and 0.0 < self.every < np.inf):
            raise InputError("Drifting(every)", f"{self.every}", "a time between knots in seconds, or None")

    @property
    def added(self) -> Discrepancy:
        """Error model of the added ε."""
        return self.errors

    def among(self, space: ParameterSpace, duration: float) -> Drifting:
        """Return the error model for these parameters; see `ErrorModel.among`."""
        if self.every is not None and duration > MOST_SPANS * self.every:
            raise InputError(
                "Drifting(every)",
                f"{self.every:g} s, which puts {duration / self.every:.0f} knots in a record of {duration:g} s",
                f"{duration / MOST_SPANS:.3g} s or more",
                "Use a longer time between knots: parameters that change in every cycle can fit any measurement.",
            )
        return replace(self, every=self.every or duration / SPANS, _space=space)

    @property
    def _drifting(self) -> ParameterSpace:
        assert self._space is not None, "a posterior must first bind the error model to its parameters"
        return self._space

    def _knots(self, duration: float) -> int:
        assert self.every is not None
        return 1 + max(1, int(np.ceil(duration / self.every - 1e-6)))

    @property
    def shared_parameters(self) -> dict[str, Marginal]:
        """d_j of every parameter, in its unit."""
        priors = {}
        for name, marginal in self._drifting.marginals.items():
            sd = marginal.moments[1] / factor(marginal.unit)
            priors[drift_name(name)] = LogNormal(
                log_mean=float(np.log(DRIFT_MEDIAN * sd)), log_sd=DRIFT_LOG_SD, unit=marginal.unit
            )
        return priors

    def hidden_parameters(self, duration: float) -> dict[str, Marginal]:
        """Values of every b_j at the knots; see `ErrorModel.hidden_parameters`."""
        return {name: Normal(0.0, 1.0) for name in knot_names(self._drifting.names, self._knots(duration))}

    def scatters(self, duration: float) -> dict[tuple[str, str], tuple[str, ...]]:
        """Values of each parameter at the knots; see `ErrorModel.scatters`."""
        knots = self._knots(duration)
        return {(name, drift_name(name)): knot_names((name,), knots) for name in self._drifting.names}

    def responding(self, model: Model, duration: float) -> Model:
        """Return the model with drifting parameters; see `ErrorModel.responding`."""
        assert self.every is not None
        return DriftingModel(model, self._drifting, self._knots(duration), self.every)

    def describe(self) -> dict[str, Any]:
        """Return the kind of this error model, the time between knots, and the error model of the added errors."""
        return {"kind": "drifting", "every": self.every, "errors": self.errors.describe()}


ERRORS = {kind.word: kind.error_model for kind in (IID_KIND, AR1_KIND, DAMPED_COSINE_KIND)}
"""Error models of the errors added to the response, by their names in a study file."""


def _of_words(every: float | None = None, errors: str = "iid") -> Drifting:
    return Drifting(every, ERRORS[errors]())


DRIFTING_KIND = ErrorModelKind(_of_words, "drifting", {"every": "s"}, {"errors": (Literal[tuple(ERRORS)], "iid")})
