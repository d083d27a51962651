"""Choice among forms of a surrogate by their leave-one-out errors near the posterior."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from jaxtyping import Float

from structid.calibration.run_weights import tempered_weights
from structid.ground_motion.excitation import Excitation
from structid.inference.likelihood.posterior import Posterior

NEAR_SHARE = 0.3
"""Effective number of runs in a surrogate's error near the posterior, as a fraction of all runs."""


class KnowsItsErrors(Protocol):
    """A fitted surrogate with leave-one-out predictions."""

    def left_out(
        self, theta: Float[np.ndarray, "run parameter"], excitation: Excitation
    ) -> Float[np.ndarray, "run time channel"]:
        """Predict each run of the fit from all other runs."""


def best_near_the_posterior(
    found: Sequence[KnowsItsErrors],
    posterior: Posterior,
    theta: Float[np.ndarray, "run parameter"],
    log_true: Float[np.ndarray, " run"],
    ran: Sequence[np.ndarray],
) -> int:
    """Choose among surrogates fitted to the same runs."""
    errors = [error_near_the_posterior(one, posterior, theta, log_true, ran) for one in found]
    return int(np.argmin(errors))


def error_near_the_posterior(
    surrogate: KnowsItsErrors,
    posterior: Posterior,
    theta: Float[np.ndarray, "run parameter"],
    log_true: Float[np.ndarray, " run"],
    ran: Sequence[np.ndarray],
) -> float:
    """Leave-one-out error of the tempered log density, weighted by the tempered posterior.

    The most accurate surrogate over the whole prior need not be the most accurate one near the posterior.
    """
    parameters = np.asarray(posterior.model_parameters(theta))
    responses = (
        _among_all(surrogate.left_out(parameters[fitted], observation.record), fitted)
        for observation, fitted in zip(posterior.observations, ran, strict=True)
    )
    with np.errstate(invalid="ignore"):  # both may be −inf
        error = log_true - posterior.given(responses).log_density(theta)
    exponent, weights = tempered_weights(log_true, NEAR_SHARE)
    usable = np.isfinite(error) & (weights > 0.0)
    return (
        float(exponent * np.sqrt(np.average(error[usable] ** 2, weights=weights[usable]))) if usable.any() else np.inf
    )


def _among_all(values: np.ndarray, ran: np.ndarray) -> np.ndarray:
    """Place the responses of some runs at their positions among all runs, with NaN elsewhere."""
    everywhere = np.full((len(ran), *values.shape[1:]), np.nan)
    everywhere[ran] = values
    return everywhere
