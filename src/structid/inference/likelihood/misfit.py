"""The deterministic misfit J(θ), its gradient, and the Gauss-Newton approximation of its Hessian.

Numbers in brackets, such as [3.22], are equations of the MSc thesis in docs/bibliography.md.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property, partial
from typing import Any

import jax
import numpy as np
from jaxtyping import Float

from structid.engine.batches import in_batches
from structid.engine.device import jnp, over_runs
from structid.engine.lanes.in_lanes import InLanes
from structid.engine.slopes import with_slopes
from structid.engine.time_loop import Fold, TimeLoop, with_sensitivities
from structid.inference.likelihood.joint_likelihood import JointLikelihood
from structid.inference.likelihood.observation_likelihood import Measured, ObservationLikelihood
from structid.inference.likelihood.shared_response import squares_of
from structid.models.traceable import as_traceable
from structid.observation import Observation
from structid.probability.space import ParameterSpace

GRADIENT_BATCH = 64
"""Number of runs differentiated at once; every parameter adds one history to each run."""


class Misfit:
    """J(θ) = Σ (y − M(θ))² [3.22] of the model's parameters θ, with nuisance parameters at their prior medians.

    With several channels, every channel's sum is divided by its Σ y², since units differ; a single channel is not scaled.

    Parameters
    ----------
    model_space : ParameterSpace
        The model's parameters and their priors.
    likelihood : JointLikelihood
        Model and measurements.
    """

    def __init__(self, model_space: ParameterSpace, likelihood: JointLikelihood) -> None:
        self.space = model_space
        self.names = self.space.names
        self._likelihood = likelihood
        extra = list(likelihood.space.marginals.values())[self.space.dimension :]
        self._rest = np.array([float(m.quantile(np.array(0.5))) for m in extra])

    @property
    def differentiable(self) -> bool:
        """Whether the model has derivatives."""
        return self._likelihood.model.traceable

    @cached_property
    def scale(self) -> float:
        """Σ y² over all measurements, weighted as in J."""
        return float(sum(np.nansum(o.values**2 * w) for o, w in zip(self._observations, self._weights, strict=True)))

    @property
    def _observations(self) -> list[Observation]:
        return [bound.observation for bound in self._likelihood.of]

    @cached_property
    def _weights(self) -> list[np.ndarray]:
        observations = self._observations
        if all(len(o.channels) == 1 for o in observations) and len({o.channels for o in observations}) == 1:
            return [np.ones(1) for _ in observations]
        return [1.0 / (o.weighted(o.values) ** 2).sum(axis=0) for o in observations]

    def _with_rest(self, theta: Any) -> Any:
        """All parameters of the posterior, inside JAX: the model's, and all further parameters at their fixed values."""
        return jnp.concatenate([theta, jnp.broadcast_to(self._rest, (theta.shape[0], self._rest.size))], axis=1)

    def _residuals(self, theta: Any, data: Any) -> Any:
        """All weighted residuals of every run, (residual, run)."""
        full, likelihood, parts = self._with_rest(theta), self._likelihood, []
        for numbers in likelihood.of_one_run:
            response, _ = likelihood.of[numbers[0]].response(full, data[numbers[0]])
            for k in numbers:
                residual = likelihood.of[k].residual_of_all(response, full, data[k].values)
                parts.append((residual * np.sqrt(self._weights[k])[:, None]).reshape(-1, theta.shape[0]))
        return jnp.concatenate(parts)

    def _value(self, theta: Any, data: Any) -> Any:
        """J(θ) inside JAX, shape (run,); +inf where the response is not finite."""
        full = self._with_rest(theta)
        total = jnp.zeros(theta.shape[0])
        for numbers in self._likelihood.of_one_run:
            bounds = [self._likelihood.of[k] for k in numbers]
            squares, finite = squares_of(bounds, full, [data[k] for k in numbers])
            for k, squares_of_observation in zip(numbers, squares, strict=True):
                total = total + jnp.where(
                    finite, (self._weights[k][:, None] * squares_of_observation).sum(axis=0), jnp.inf
                )
        return total

    def _linearised(self, theta: Any, data: Any) -> tuple[Any, Any, Any]:
        """J (run,), ∇J (run, parameter) and 2 JᵀJ (run, parameter, parameter) inside JAX, from whole histories."""
        residual, jacobian = with_slopes(lambda t: self._residuals(t, data), theta)
        gradient = 2.0 * jnp.einsum("tb,ptb->bp", residual, jacobian)
        return (residual**2).sum(axis=0), gradient, 2.0 * jnp.einsum("ptb,qtb->bpq", jacobian, jacobian)

    def _linearised_on_the_way(self, theta: Any, data: Any) -> tuple[Any, Any, Any]:
        """J, ∇J and 2 JᵀJ inside JAX, summed in a loop over time with sensitivities, without storing histories."""
        sums_of_observations = []
        for numbers in self._likelihood.of_one_run:
            first = numbers[0]
            loop = with_sensitivities(partial(self._loop, self._likelihood.of[first], data[first]), theta.T)
            values = tuple(self._likelihood.of[k].readings(data[k].values) for k in numbers)
            sums_of_observations.append(loop.folded(_normal_equations(theta), values, self._sample(numbers, theta))[0])
        value, gradient, *rows = (sum(parts) for parts in zip(*sums_of_observations, strict=True))
        names = range(len(rows))
        whole = [jnp.stack([rows[max(i, j)][min(i, j)] for j in names], axis=-1) for i in names]
        return value, 2.0 * gradient.T, 2.0 * jnp.stack(whole, axis=1)

    def _sample(self, numbers: Sequence[int], theta: Any) -> Callable[[Any, Any], tuple[Any, Any]]:
        """Weighted residuals of some observations at one sample (channel, run), with derivatives (parameter, channel, run)."""
        full = self._with_rest(theta)
        bounds = [self._likelihood.of[k] for k in numbers]
        residuals = [bound.residual(full) for bound in bounds]
        roots = [np.sqrt(self._weights[k])[:, None] for k in numbers]

        def sample(outputs: tuple[Any, Any], measured_row: Sequence[Any]) -> tuple[Any, Any]:
            def weighted(response: Any) -> Any:
                each = zip(roots, bounds, residuals, measured_row, strict=True)
                return jnp.concatenate(
                    [root * residual(bound.measured_channels(response), y) for root, bound, residual, y in each]
                )

            residual, slope_along = jax.linearize(weighted, outputs[0])
            return residual, jax.vmap(slope_along)(outputs[1])

        return sample

    def _loop(self, bound: ObservationLikelihood, measured: Measured, theta: Any) -> TimeLoop:
        """The loop over time for parameters (parameter, run)."""
        loop = bound.loop(bound.parameters(self._with_rest(theta.T)), measured)
        assert loop is not None  # `_compiled` has checked this
        return loop

    @cached_property
    def _compiled(self) -> dict[str, Callable[..., Any]]:
        likelihood, some = self._likelihood, self.space.sample(1, seed=0).values
        looping = all(
            bound.takes_samples
            and bound.reads_every_sample
            and bound.loop(bound.parameters(self._with_rest(some)), measured) is not None
            for bound, measured in zip(likelihood.of, likelihood.measured, strict=True)
        )
        value = InLanes(lambda theta, data: (self._value(theta, data),))
        return {
            "value": value,
            "linearised": InLanes(self._linearised_on_the_way) if looping else over_runs(self._linearised),
        }

    def __call__(self, theta: Float[np.ndarray, "run parameter"]) -> Float[np.ndarray, " run"]:
        """Misfit."""
        theta = np.atleast_2d(np.asarray(theta, dtype=np.float64))
        if self.differentiable:
            (value,) = in_batches(self._compiled["value"], theta, self._likelihood.measured)
        else:
            full = np.concatenate([theta, np.tile(self._rest, (len(theta), 1))], axis=1)
            value = sum(
                (
                    (o.weighted((o.values - self._likelihood.predict(full, i)).transpose(1, 2, 0)) ** 2)
                    * self._weights[i][:, None]
                ).sum(axis=(0, 1))
                for i, o in enumerate(self._observations)
            )
        return np.where(np.isfinite(value), value, np.inf)

    def linearised(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Misfit, its exact gradient, and the Gauss-Newton approximation of its Hessian.

        Parameters
        ----------
        theta : ndarray, shape (run, parameter)
            The model's parameters in SI.

        Returns
        -------
        tuple of ndarray
            J (run,), ∇J (run, parameter), 2 JᵀJ (run, parameter, parameter).

        Raises
        ------
        InputError
            If the model is not built in and therefore has no derivatives.
        """
        theta = np.atleast_2d(np.asarray(theta, dtype=np.float64))
        as_traceable(self._likelihood.model, "misfit gradient", cure="Use pattern search, which needs no derivatives.")
        compiled = self._compiled["linearised"]
        value, gradient, hessian = in_batches(compiled, theta, self._likelihood.measured, GRADIENT_BATCH)
        return value, gradient, hessian


def _normal_equations(theta: Any) -> Fold:
    """Sums of r² (run,), of r ∂r (parameter, run), and of each row of ∂r ∂rᵀ up to its diagonal, over samples.

    A sample consists of residuals r (channel, run) and their derivatives (parameter, channel, run).
    """
    runs, parameters = theta.shape

    def step(sums: Any, sample: Any) -> Any:
        value, gradient, *rows = sums
        residual, slopes = sample
        products = [row + (slopes[i] * slopes[: i + 1]).sum(axis=1) for i, row in enumerate(rows)]
        return value + (residual**2).sum(axis=0), gradient + (residual * slopes).sum(axis=1), *products

    rows = [jnp.zeros((i + 1, runs)) for i in range(parameters)]
    return Fold((jnp.zeros(runs), jnp.zeros((parameters, runs)), *rows), step, lambda sums: sums)
