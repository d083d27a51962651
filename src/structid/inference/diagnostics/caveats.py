"""Caveats besides convergence: a model that contradicts the data, a surrogate that is too inaccurate."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from structid.inference.likelihood.posterior import Posterior
from structid.inference.prediction.best_prediction import UNEXPLAINED_LIMIT, BestPrediction
from structid.inference.prediction.parameter_drift import ParameterDrift
from structid.models.base import StandIn

SURROGATE_NATS = 2.0
"""Change of the log-likelihood due to a surrogate's mean error above which a warning is given [nat]."""


def wrong_model(best: BestPrediction, drift: ParameterDrift | None, mean: Float[np.ndarray, " parameter"]) -> list[str]:
    """Evidence against the model, one sentence each."""
    sentences = []
    if best.unexplained > UNEXPLAINED_LIMIT:
        left = (
            f"The model's best prediction leaves {100.0 * best.unexplained:.0f} % of the measured variance unexplained"
        )
        if best.of_another_size:
            left += (
                f", and its peak is {best.peak:.2g} times the measured peak: check the units of measurement, record and priors; "
                "numbers without a unit are in SI"
            )
        sentences.append(left + ".")
    if drift is not None and drift.found:
        sentences.append(drift.sentence(mean))
    return sentences


def surrogate_warnings(
    posterior: Posterior, draws: Float[np.ndarray, "draw parameter"], unexplained: float, certified: bool | None
) -> list[str]:
    """Warnings that a surrogate may have shifted the posterior."""
    stand_in = posterior.model.stand_in
    if stand_in is None or certified:
        return []
    warnings = []
    if certified is None and _matters(posterior, stand_in, unexplained):
        warnings.append(
            f"the surrogate's error ({stand_in.relative_error:.1g} of the response's variance) is not small compared with the "
            f"unexplained variance ({unexplained:.1g}): it may have shifted the posterior; do more model runs, or certify it with "
            "structid.calibrate"
        )
    outside = float(stand_in.outside(np.asarray(posterior.model_parameters(draws))).mean())
    if outside > 0.0:
        cure = (
            "widen its design, or do more model runs there"
            if certified is None
            else "the next model runs are placed there"
        )
        warnings.append(
            f"{outside:.1%} of the draws lie outside the range of the surrogate's runs, where the surrogate is unreliable: "
            + cure
        )
    return warnings


def _matters(posterior: Posterior, stand_in: StandIn, unexplained: float) -> bool:
    """Whether T/2 · ε/u, with surrogate error ε and unexplained variance u, exceeds `SURROGATE_NATS`."""
    samples = sum(int(o.is_measured.any(axis=1).sum()) for o in posterior.observations)
    return 0.5 * samples * stand_in.relative_error > SURROGATE_NATS * unexplained
