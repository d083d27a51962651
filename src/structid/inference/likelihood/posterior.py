"""The posterior of a model's parameters given measured histories.

Numbers in brackets, such as [3.22], are equations of the MSc thesis in docs/bibliography.md.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import cached_property
from typing import Any

import jax
import numpy as np

from structid.core.channels import check_channels
from structid.core.errors import InputError
from structid.core.hashing import digest
from structid.core.progress import Progress
from structid.core.renamed import renamed_argument, renamed_attribute
from structid.core.units import same_dimension, squared
from structid.core.validation import check_arguments
from structid.engine.batches import LARGEST_BATCH, in_batches
from structid.engine.device import BATCH_SIZES, jnp
from structid.engine.lanes.differentiable import differentiable_in_lanes
from structid.engine.lanes.in_lanes import InLanes
from structid.inference.error_models.base import ErrorModel
from structid.inference.error_models.independent import IID
from structid.inference.likelihood.given_responses import GivenResponses, Responses, log_density_on_the_way
from structid.inference.likelihood.joint_likelihood import JointLikelihood
from structid.inference.likelihood.misfit import Misfit
from structid.inference.likelihood.observation_likelihood import Measured
from structid.inference.target import Target
from structid.models.base import Map, Model
from structid.observation import Observation
from structid.probability.space import ParameterSpace


@check_arguments
class Posterior(Target):
    """π(θ | y) ∝ π(θ) L(y | θ) for one or several measured histories that share the model's parameters.

    Parameters
    ----------
    space : ParameterSpace
        The model's unknown parameters and their priors.
    model : Model
        Any model: built in, external, or a surrogate.
    observations : Observation or sequence of Observation
        The measurements; each has its own error and nuisance parameters, numbered ``_1``, ``_2``, … when there are several.
    discrepancy : ErrorModel
        The error model: errors that are added to the response, or inside the model.
    map : callable, optional
        Maps the runs of an external model, like ``Executor.map``.
    refuse_unfit : bool
        Refuse a surrogate whose error exceeds its limit.
    model_error : bool
        Add a surrogate's own variance to the error variance. Where the surrogate is uncertain, the data then have less weight. For
        a `PODKriging` or `PODPCE` of one channel and independent errors, the surrogate's error is integrated out exactly. Otherwise
        its variance, averaged over time, is treated as white noise. Do not use this with a surrogate that is uncertain over large
        parts of the prior. A variance as large as the response explains any measurement, and the posterior moves there.

    Attributes
    ----------
    names : tuple of str
        The model's parameters, then the nuisance parameters, then the error model's parameters.
    error_model, discrepancy : ErrorModel, Discrepancy
        All errors between model and measurement, and the part of them that is added to the response.

    Examples
    --------
    >>> import numpy as np
    >>> import structid as si
    >>> record = si.GroundMotion.synthetic(seed=7)
    >>> space = si.ParameterSpace(stiffness=si.Uniform(6.0, 9.0, unit="kN/mm"))
    >>> model = si.BoucWen(mass=12e3, damping_ratio=0.03, alpha=0.05, beta=63.0, gamma=63.0, free=space.names)
    >>> velocity = model.run(space.quantile(0.5 * np.ones((1, 1))), record).values[0]
    >>> posterior = si.Posterior(space, model, si.Observation(record, velocity, channels=model.channels), discrepancy=si.IID())
    >>> posterior.names
    ('stiffness', 'sigma2')
    """

    def __init__(
        self,
        space: ParameterSpace,
        model: Model,
        observations: Observation | Sequence[Observation],
        discrepancy: ErrorModel | None = None,
        map: Map | None = None,
        refuse_unfit: bool = True,
        model_error: bool = False,
    ) -> None:
        self.model_space, self.model, self.map, self.model_error = space, model, map, model_error
        self.observations = (observations,) if isinstance(observations, Observation) else tuple(observations)
        self._check(refuse_unfit)
        error_model = IID() if discrepancy is None else discrepancy
        self.likelihood = JointLikelihood(
            space, model, self.observations, error_model, map=map, model_error=model_error
        )
        self.error_model, self.space = self.likelihood.error_model, self.likelihood.space
        self.discrepancy = self.error_model.added
        self.names, self.own = self.space.names, list(range(space.dimension))
        self.bijection = self.likelihood.bijection

    def _check(self, refuse_unfit: bool) -> None:
        """Refuse arguments that do not fit together."""
        if not self.observations:
            raise InputError("Posterior.observations", "no observation", "one Observation or more")
        self.model.check_names(self.model_space.names, self.model_space.all_names)
        self.model.check_priors(self.model_space)
        if refuse_unfit and self.model.stand_in is not None:
            self.model.stand_in.check_fitness()
        for number, observation in enumerate(self.observations):
            observation.check_new(self.observations[:number])
            check_channels("observation.channels", observation.channels, self.model.channels)
            self.model.check_excitation(observation.record)

    def _like(self, **changes: Any) -> Posterior:
        """Copy of this posterior with some settings changed; the surrogate is not checked again."""
        settings: dict[str, Any] = {
            "space": self.model_space,
            "model": self.model,
            "observations": self.observations,
            "discrepancy": self.error_model,
            "map": self.map,
            "refuse_unfit": False,
            "model_error": self.model_error,
        }
        return Posterior(**(settings | changes))

    @property
    def knows_prior(self) -> bool:
        """True: prior and likelihood can be evaluated separately."""
        return True

    @property
    def hidden(self) -> frozenset[str]:
        """Names of the latent values of the errors inside the model; see `ErrorModel.hidden_parameters`."""
        return self.likelihood.hidden_names

    @property
    def variances(self) -> frozenset[str]:
        """Names of the error model's variances; they begin with ``sigma2`` in every error model."""
        return frozenset(n for n in self.names[self.model_space.dimension :] if n.startswith("sigma2"))

    @property
    def sd_units(self) -> dict[str, str]:
        """Display unit of the square root of each variance, which is the measured channel's unit."""
        displays = {
            si: observation.channel_unit(channel).display if si else ""
            for observation in self.observations
            for channel, si in zip(observation.channels, observation.error_units, strict=True)
        }
        return {
            name: display
            for name in self.names
            if name in self.variances
            for si, display in displays.items()
            if same_dimension(squared(si), self.units[name])
        }

    @property
    def costs_runs(self) -> bool:
        """Whether each evaluation is a run of an expensive solver."""
        return not self.model.batched

    def traceable(self) -> tuple[Callable[[Any, Any], Any], Any]:
        """Return the density as a JAX function; see `Target.traceable`."""
        if not self.model.traceable:
            return super().traceable()
        in_lanes = self._differentiable_in_lanes
        return (self._in_coordinates, self.data) if in_lanes is None else (lambda phi, _: in_lanes(phi), ())

    def mapped_by(self, map: Map | None) -> Posterior:
        """Return the same posterior, with a map that makes the runs of an external solver.

        Parameters
        ----------
        map : callable or None
            Like ``Executor.map``.

        Returns
        -------
        Posterior
            Posterior with the same density.
        """
        return self._like(map=map)

    law = renamed_attribute("law", "error_model")

    @renamed_argument(law="error_model")
    def on(
        self, model: Model | None = None, refuse_unfit: bool = True, error_model: ErrorModel | None = None
    ) -> Posterior:
        """Return the posterior of the same parameters and data with another model, such as a surrogate, or error model.

        Parameters
        ----------
        model : Model, optional
            The model; by default this posterior's model.
        refuse_unfit : bool
            Refuse a surrogate whose error exceeds its limit.
        error_model : ErrorModel, optional
            The error model; by default this posterior's error model.

        Returns
        -------
        Posterior
            Posterior with the new model and error model.
        """
        changed = {} if error_model is None else {"discrepancy": error_model}
        other = self._like(**changed, **({} if model is None else {"model": model, "refuse_unfit": refuse_unfit}))
        if error_model is None and other.model.channels == self.model.channels:
            # Compiled once for all surrogates of a calibration, since the function depends only on responses.
            other._compiled_given = self._compiled_given
        return other

    @property
    def units(self) -> dict[str, str]:
        """Display unit of every parameter."""
        return self.space.units

    @property
    def factors(self) -> np.ndarray:
        """SI value of one display unit, shape (parameter,)."""
        return self.space.factors

    @cached_property
    def content_hash(self) -> str:
        """Hash of prior, model, measurements and error model."""
        described = [o.describe() for o in self.observations]
        parts = [self.space.content_hash, self.model.content_hash, described, self.error_model.describe()]
        return digest(*parts, *(["model error"] if self.model_error else []))

    def initial(self, count: int, rng: np.random.Generator) -> np.ndarray:
        """Draw starting points from the prior; see `Target.initial`."""
        return self.bijection.inverse(self.space.from_uniform(rng.random((count, self.dimension))))

    # --- pieces of the density ----------------------------------------------------------------------------------

    def unknowns(self, theta: Any, index: int) -> dict[str, Any]:
        """Nuisance and error-model parameters of one observation, by their plain names.

        Parameters
        ----------
        theta : array, shape (run, parameter)
            All parameters.
        index : int
            Index of the observation.

        Returns
        -------
        dict of str to array (run,)
            The values.
        """
        return self.likelihood.of[index].unknowns(theta)

    def model_parameters(self, theta: Any) -> Any:
        """Columns of the model's free parameters.

        Parameters
        ----------
        theta : array, shape (run, parameter)
            All parameters.

        Returns
        -------
        array, shape (run, free parameter)
            Columns in the model's order.
        """
        return self.likelihood.model_parameters(theta)

    @property
    def data(self) -> tuple[Measured, ...]:
        """Input of the density inside JAX, for each observation."""
        return self.likelihood.measured

    def _parts(self, theta: Any, data: Sequence[Measured]) -> tuple[Any, Any, Any]:
        """Log prior, log-likelihood and failure of every run, inside JAX."""
        likelihood, finite = self.likelihood.traced(theta, data)
        prior = self.space.jax_log_density(theta)
        inside = jnp.isfinite(prior)
        return jnp.where(inside, prior, -jnp.inf), jnp.where(finite & inside, likelihood, -jnp.inf), inside & ~finite

    def parts_in_coordinates(self, phi: Any, data: Sequence[Measured]) -> tuple[Any, Any, Any]:
        """Log prior and log-likelihood, inside JAX.

        Parameters
        ----------
        phi : jax.Array, shape (run, parameter)
            Unconstrained coordinates.
        data : sequence of Measured
            Data of each observation: `data`, or other measurements.

        Returns
        -------
        tuple of jax.Array, shape (run,)
            Log prior with respect to φ, log-likelihood, and a mask of the failed simulations.
        """
        theta, jacobian = self.bijection.forward(phi)
        prior, likelihood, failed = self._parts(theta, data)
        return prior + jacobian, likelihood, failed

    def _in_coordinates(self, phi: Any, data: Sequence[Measured]) -> Any:
        return sum(self.parts_in_coordinates(phi, data)[:2])

    # --- densities on the host ----------------------------------------------------------------------------------

    @cached_property
    def _compiled(self) -> Callable[..., Any]:
        # The only JAX program that contains the model: φ is mapped on the host, so that no model is compiled twice.
        return InLanes(self._parts, shard=self.likelihood.loops_over_time)

    def _evaluate(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Log prior, log-likelihood and failure of every run."""
        theta = self.likelihood.points(theta)
        if self.model.traceable:
            size = LARGEST_BATCH if self.likelihood.loops_over_time else BATCH_SIZES[-1]
            prior, likelihood, failed = in_batches(self._compiled, theta, self.data, size)
            return prior, likelihood, failed
        prior = self.space.log_density(theta)
        return prior, *self.likelihood.on_host(theta, np.isfinite(prior))

    def log_density(self, theta: np.ndarray) -> np.ndarray:
        """Unnormalised log posterior density; see `Target.log_density`."""
        prior, likelihood, _ = self._evaluate(theta)
        return np.asarray(prior + likelihood)

    def log_likelihood(self, theta: np.ndarray) -> np.ndarray:
        """Log-likelihood.

        Parameters
        ----------
        theta : ndarray, shape (run, parameter)
            Parameters in SI.

        Returns
        -------
        ndarray, shape (run,)
            −inf outside the support and where the simulation failed.
        """
        return self._evaluate(theta)[1]

    def evaluate(self, phi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Log density in unconstrained coordinates; see `Target.evaluate`."""
        prior, likelihood, failed = self.evaluate_parts(phi)
        return prior + likelihood, failed

    def evaluate_parts(self, phi: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Log prior and log-likelihood; see `Target.evaluate_parts`."""
        compiled = self._compiled_in_lanes
        if compiled is not None:
            prior, likelihood, failed = compiled(phi)
            return prior, likelihood, failed
        theta, jacobian = self.bijection(phi)
        prior, likelihood, failed = self._evaluate(theta)
        return prior + jacobian, likelihood, failed

    @property
    def in_lanes(self) -> bool:
        """Whether the density is compiled to vector code, which takes a small fraction of JAX's time for many runs."""
        return self._compiled_in_lanes is not None

    @cached_property
    def _compiled_in_lanes(self) -> Callable[[np.ndarray], Any] | None:
        """Vector code of the density in unconstrained coordinates, bijection included; None if it cannot be compiled."""
        if not self.model.traceable:
            return None
        return InLanes(self.parts_in_coordinates).compiled(self.dimension, (self.data,))

    @cached_property
    def _differentiable_in_lanes(self) -> Callable[[Any], Any] | None:
        """Vector code of the density and its gradient, inside JAX; None if it cannot be compiled."""
        return differentiable_in_lanes(self._in_coordinates, self.dimension, (self.data,))

    def __getstate__(self) -> dict[str, Any]:
        # Compiled code is valid in this process only.
        return {k: v for k, v in self.__dict__.items() if not k.endswith("_in_lanes") and k != "_compiled_given"}

    def given(self, responses: Iterable[Responses]) -> GivenResponses:
        """Use responses computed beforehand, such as the runs of a campaign, instead of the model's.

        Parameters
        ----------
        responses : iterable of ndarray, shape (run, time, channel)
            The model's response to the record of each observation, in the model's channels; NaN where it failed.
            Instead of one array, an iterator of blocks of runs needs memory for one block only.

        Returns
        -------
        GivenResponses
            Posterior that computes the log density of parameters; each row of parameters belongs to one run.
        """
        return GivenResponses(self.likelihood, responses, self._compiled_given)

    def log_density_given(self, responses: Iterable[Responses], theta: np.ndarray) -> np.ndarray:
        """Log density with responses computed beforehand, of which no more than one block is kept; see `given`.

        Parameters
        ----------
        responses : iterable
            The model's response to the record of each observation: arrays (run, time, channel), or iterators of blocks of runs.
        theta : ndarray, shape (run, parameter)
            The parameters of every run.

        Returns
        -------
        ndarray, shape (run,)
            Log density; −inf where a run failed.
        """
        return log_density_on_the_way(self.likelihood, responses, self._compiled_given, self.likelihood.points(theta))

    @cached_property
    def _compiled_given(self) -> tuple[Callable[..., Any], ...]:
        """Log-likelihood of responses to the record of each observation."""
        return tuple(jax.jit(bound.given_measured) for bound in self.likelihood.of)

    def predict(self, theta: np.ndarray, index: int = 0, progress: Progress | None = None) -> np.ndarray:
        """Prediction of one observation, including the instrument, without errors.

        Parameters
        ----------
        theta : ndarray, shape (run, parameter)
            Parameters in SI.
        index : int
            Index of the observation.
        progress : callable, optional
            Called with the number of finished runs and the total.

        Returns
        -------
        ndarray, shape (run, time, channel)
            Predictions in SI; NaN where a run failed.
        """
        return self.likelihood.predict(theta, index, progress)

    def pointwise_log_likelihood(
        self, theta: np.ndarray, index: int = 0, prediction: np.ndarray | None = None
    ) -> np.ndarray:
        """Log-likelihood of every observed value.

        Parameters
        ----------
        theta : ndarray, shape (run, parameter)
            Parameters in SI.
        index : int
            Index of the observation.
        prediction : ndarray, shape (run, time, channel), optional
            Result of `predict`, if available.

        Returns
        -------
        ndarray, shape (run, time, channel)
            Log densities, and 0 for missing values; for an unknown polarity, those of the more probable direction.
        """
        theta = self.likelihood.points(theta)
        prediction = self.predict(theta, index) if prediction is None else prediction
        result = self.likelihood.of[index].pointwise(prediction.transpose(1, 2, 0), self.unknowns(theta, index))
        return result.transpose(2, 0, 1)

    @cached_property
    def misfit(self) -> Any:
        """The sum of squared residuals J(θ) [3.22] of the model's parameters; see `Misfit`."""
        return Misfit(self.model_space, self.likelihood)
