"""A model whose parameters drift during the response, a common type of model error."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float

from structid.core.arrays import Array
from structid.core.channels import ChannelUnit
from structid.core.errors import InputError
from structid.core.hashing import digest
from structid.engine.device import jnp
from structid.engine.time_loop import State, TimeLoop
from structid.ground_motion.excitation import Excitation
from structid.models.base import Model
from structid.models.traceable import TraceableModel, TracedExcitation, as_traceable
from structid.probability.space import ParameterSpace


def drift_name(name: str) -> str:
    """Return the name of the standard deviation of a parameter's drift."""
    return f"{name}_drift"


def knot_names(names: tuple[str, ...], knots: int) -> tuple[str, ...]:
    """Return the names of the drifts at the knots."""
    return tuple(f"{name}_at_{knot}" for name in names for knot in range(1, knots + 1))


class DriftingModel(TraceableModel):
    """A model with parameters that are piecewise linear in time.

    θ_j(t) = θ_j + d_j b_j(t),   b_j linear between its values at knots, b_j(t_k) ~ N(0, 1) a priori

    At a knot, θ is clipped to the support of its prior; θ(t) is constant between samples. Derived parameters, and
    quantities computed from the parameters (such as damping from the initial stiffness), drift with them.
    """

    def __init__(self, model: Model, space: ParameterSpace, knots: int, every: float) -> None:
        allowed = "a built-in oscillator or frame"
        cure = "Use iid, ar1 or damped_cosine errors, which are available for any model."
        self.model = as_traceable(model, "drifting parameters", allowed, cure)
        if not model.can_drift:
            raise InputError(
                "drifting parameters", f"a {type(model).__name__}, which has no loop over time", allowed, cure
            )
        self.space, self.knots, self.every = space, knots, every
        self.channels, self.substeps = self.model.channels, self.model.substeps
        self.free = (*space.names, *map(drift_name, space.names), *knot_names(space.names, knots))

    @property
    def channel_units(self) -> dict[str, ChannelUnit]:
        """Units of the channels of the wrapped model."""
        return self.model.channel_units

    @property
    def loop_channels(self) -> Mapping[str, tuple[str, str, str]]:
        """Channels of the hysteresis loops of the wrapped model; see `Model.loop_channels`."""
        return self.model.loop_channels

    @property
    def kind_in_words(self) -> str:
        """Descriptive name of the wrapped model and its drift."""
        return f"{self.model.kind_in_words} with drifting parameters"

    @cached_property
    def content_hash(self) -> str:
        """Hash of the model, the drifting parameters and the knots."""
        return digest("DriftingModel", self.model.content_hash, self.space.content_hash, self.knots, self.every)

    def recording(self, *channels: str) -> DriftingModel:
        """Return this model with other channels; see `Model.recording`."""
        return DriftingModel(self.model.recording(*channels), self.space, self.knots, self.every)

    def check_excitation(self, excitation: Excitation) -> None:
        """Refuse an excitation that the wrapped model refuses; see `Model.check_excitation`."""
        self.model.check_excitation(excitation)

    def at_knots(self, theta: Float[Array, "run parameter"]) -> Float[Array, "run knot sampled_parameter"]:
        """Return θ_j + d_j b_jk, clipped to the support of the prior."""
        count = self.space.dimension
        mean, drift = theta[:, None, :count], theta[:, None, count : 2 * count]
        at = theta[:, 2 * count :].reshape(-1, count, self.knots).swapaxes(1, 2)
        low, high = self.space.bounds.T
        return jnp.clip(mean + drift * at, low, high)

    def time_loop(self, theta: Float[Array, "run parameter"], excitation: TracedExcitation) -> TimeLoop:
        """Return the loop over the record; see `TraceableModel.time_loop`."""
        at_knots = self.at_knots(theta)
        shares = _shares(excitation.stages.shape[0], excitation.dropped_samples, excitation.dt / self.every, self.knots)

        def loop_of(parameters: Any) -> TimeLoop:
            loop = self.model.time_loop(self.space.columns(parameters, self.model.free), excitation)
            assert loop is not None
            return loop

        def step(state: State, row: tuple[Any, Any]) -> tuple[State, Any]:
            share, rest = row
            return loop_of(jnp.einsum("rkp,k->rp", at_knots, share)).step(state, rest)

        first = loop_of(at_knots[:, 0])
        return first._replace(step=step, rows=(jnp.asarray(shares), first.rows))


def _shares(rows: int, before: int, step: float, knots: int) -> np.ndarray:
    """Return the weights (row, knot) of the knots; rows are `step` knots apart, and row `before` is at knot 1."""
    return hats((np.arange(rows) - before) * step, knots)


def hats(at: Float[np.ndarray, " row"], knots: int) -> Float[np.ndarray, "row knot"]:
    """Return weights of linear interpolation between knots at 0, 1, 2, …; they are constant beyond the end knots."""
    at = np.clip(at, 0.0, knots - 1.0)
    return np.asarray(np.maximum(0.0, 1.0 - np.abs(at[:, None] - np.arange(knots))))
