"""A surrogate of somebody else's: every sample a quadratic of the parameters, by least squares."""

from dataclasses import asdict, dataclass
from typing import ClassVar

import numpy as np

from structid.engine.device import jnp
from structid.surrogates.base import Surrogate
from structid.surrogates.fit import Fit, check_enough, common_step, fitted_range, fitting_runs, run_digests
from structid.surrogates.surrogate_kind import SurrogateKind


@dataclass(frozen=True)
class QuadraticResponse:
    """Settings."""

    degree: int = 2
    limit: float = 0.5
    outside: str = "allow"

    warm_start: ClassVar[bool] = False
    weighted: ClassVar[bool] = False

    def check(self, design, records, channels):
        check_enough("QuadraticResponse.fit", len(design), f"{len(design)} runs")

    def fit(self, runs, progress=None):
        done, left_out = fitting_runs("QuadraticResponse.fit", runs)
        kind, dt = common_step("QuadraticResponse.fit", done.records)
        theta, (low, high) = done.design.values, fitted_range(done.design)
        features = np.vander(((theta - low) / (high - low)).ravel(), self.degree + 1)
        flat = done.values.reshape(len(done), -1)
        coefficients, *_ = np.linalg.lstsq(features, flat, rcond=None)
        error = ((flat - features @ coefficients) ** 2).sum() / ((flat - flat.mean(axis=1, keepdims=True)) ** 2).sum()
        fit = Fit(
            "QuadraticResponse",
            asdict(self),
            done.design.space,
            done.channels,
            kind,
            dt,
            low,
            high,
            len(done),
            left_out,
            float(error),
            self.limit,
            self.outside,
            0.0,
            run_digests(done),
        )
        return FittedQuadratic(fit, coefficients.reshape(-1, *done.values.shape[1:]))


class FittedQuadratic(Surrogate):
    """Fitted."""

    loops = False
    own_records = True

    def __init__(self, fit, coefficients):
        super().__init__(fit)
        self.coefficients = coefficients

    def response(self, theta, excitation):
        scaled = (self.held_inside(theta) - self.fitted.low) / (self.fitted.high - self.fitted.low)
        features = jnp.vander(scaled[:, 0], len(self.coefficients))
        return jnp.einsum("rk,ktc->tcr", features, self.coefficients), self.admitted(theta)

    def check_excitation(self, excitation):
        pass

    def standard_deviation(self, theta, excitation, values):
        return np.full(values.shape, np.sqrt(self.error) * values.std())

    def error_variance(self, theta, excitation, values):
        return self.error * (values**2).mean(axis=0)

    def to_plain(self):
        return {}, {"coefficients": self.coefficients}

    @classmethod
    def from_plain(cls, fit, plain, arrays):
        return cls(fit, arrays["coefficients"])


KIND = SurrogateKind(QuadraticResponse, FittedQuadratic, "quadratic_response", {"degree": int})
