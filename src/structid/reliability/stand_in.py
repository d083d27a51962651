"""A surrogate of a model for one record, fitted to runs at posterior draws."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float

from structid.campaign.runs import Runs
from structid.ground_motion.record import GroundMotion
from structid.inference.likelihood.posterior import Posterior
from structid.models.finer_steps import simulate_in_steps_it_needs
from structid.probability.designs import Design
from structid.surrogates.base import Surrogate, SurrogateSettings
from structid.surrogates.fit import FEWEST_RUNS


def fitted_stand_in(
    posterior: Posterior,
    draws: Float[np.ndarray, "draw parameter"],
    record: GroundMotion,
    channel: str,
    settings: SurrogateSettings,
) -> Surrogate | None:
    """Fit a surrogate to model runs at posterior draws; None if too few runs succeed."""
    measured = tuple(dict.fromkeys(c for o in posterior.observations for c in o.channels))
    channels = tuple(dict.fromkeys((*measured, channel)))
    space = posterior.model_space
    design = Design(draws[:, : space.dimension], space)
    model = posterior.model.recording(*channels)
    histories = simulate_in_steps_it_needs(model, design.values, record, map=posterior.map)
    if int(histories.done.sum()) < FEWEST_RUNS:
        return None
    lenient: Any = replace(settings, outside="allow")  # type: ignore[type-var]
    surrogate: Surrogate = lenient.fit(Runs.from_histories(design, histories, record))
    surrogate.trust()  # its errors are corrected by model runs
    return surrogate
