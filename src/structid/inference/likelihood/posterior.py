"""The posterior of a model's parameters given measured histories.

Numbers in brackets, such as [3.22], are equations of the MSc thesis in docs/bibliography.md.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from structid.errors import InputError
from structid.ground_motion.excitation import Excitation
from structid.ground_motion.readers import read_columns
from structid.histories import CHANNEL_UNITS, base_channel, check_channels
from structid.inference.likelihood.discrepancy import IID, Discrepancy
from structid.inference.target import Target
from structid.journal import digest
from structid.models.face import LARGEST_BATCH, JaxModel, Map, Model, Progress
from structid.probability.marginals import Marginal
from structid.probability.space import Design, ParameterSpace

NUISANCES = ("gain", "offset", "time_shift")


@dataclass(frozen=True, eq=False)
class Observation:
    """A measured response: what drove the structure, and what was recorded.

    The measurement is taken to be gain · M(θ)(t − time_shift) + offset + ε. Each nuisance is left out (1, 0, 0) unless it is given
    a prior.

    Parameters
    ----------
    record : Excitation
        What drove it.
    values : array-like, shape (time,) or (time, channel)
        The measurement in SI, at the record's samples.
    channels : sequence of str
        What was measured.
    dt : float, optional
        Its time step [s], to be checked against the record's.
    name : str
        What to call it.
    gain, offset, time_shift : Marginal, optional
        Priors of the nuisances: a pure number, the channel's unit, seconds. Gain and offset are one for each channel.

    Raises
    ------
    InputError
        If length or step differ from the record's, or a value is not finite.
    """

    record: Excitation
    values: np.ndarray
    channels: tuple[str, ...] = ("velocity",)
    dt: float | None = None
    name: str = ""
    gain: Marginal | None = None
    offset: Marginal | None = None
    time_shift: Marginal | None = None

    def __post_init__(self) -> None:
        where = f"observation '{self.name}'" if self.name else "observation"
        if not isinstance(self.record, Excitation):
            raise InputError(
                f"{where}: record",
                f"{type(self.record).__name__}",
                "a GroundMotion, ForceHistory or DisplacementHistory",
            )
        channels = (self.channels,) if isinstance(self.channels, str) else tuple(self.channels)
        values = np.array(self.values, dtype=np.float64)
        values = values[:, None] if values.ndim == 1 else values
        if values.ndim != 2 or values.shape[1] != len(channels):
            raise InputError(
                where,
                f"an array of shape {np.shape(self.values)}",
                f"(time, {len(channels)}) for the channels {', '.join(channels)}",
            )
        if len(values) != len(self.record):
            raise InputError(
                where,
                f"{len(values)} samples, and the record has {len(self.record)}",
                "as many samples as the record",
                "Trim or resample the one to the other.",
            )
        if self.dt is not None and abs(self.dt / self.record.dt - 1.0) > 1e-6:
            raise InputError(
                where,
                f"a time step of {self.dt:g} s, and the record has {self.record.dt:g} s",
                "the record's time step",
                "Resample the one to the other.",
            )
        if not np.isfinite(values).all():
            raise InputError(
                where,
                f"{np.count_nonzero(~np.isfinite(values))} values that are not finite",
                "finite numbers",
            )
        values.setflags(write=False)
        object.__setattr__(self, "values", values)
        object.__setattr__(self, "channels", channels)

    @classmethod
    def read(
        cls,
        record: Excitation,
        path: str | os.PathLike[str],
        unit: str,
        channel: str = "velocity",
        column: int | None = None,
        dt: float | None = None,
        **nuisances: Marginal,
    ) -> Observation:
        """Read a measured history from text columns.

        Parameters
        ----------
        record : Excitation
            What drove the structure.
        path : path-like
            Text or CSV with a time and a value column, or values alone with `dt`.
        unit : str
            Unit of the values.
        channel : str
            What was measured.
        column : int, optional
            Column of the values, counted from 0.
        dt : float, optional
            Time step [s] of a file without times.
        **nuisances : Marginal
            Priors of gain, offset, time_shift.

        Returns
        -------
        Observation
            The measurement.
        """
        expected = CHANNEL_UNITS.get(base_channel(channel), (None, ""))[0]
        values, step = read_columns(path, unit, dt, column, expected, from_zero=True)
        return cls(record, values, (channel,), step, str(path), **nuisances)

    def nuisances(self) -> dict[str, Marginal]:
        """Unknown nuisances and their priors.

        Returns
        -------
        dict of str to Marginal
            ``gain`` and ``offset`` once a channel, ``time_shift`` once.
        """
        priors: dict[str, Marginal] = {}
        for kind in ("gain", "offset"):
            prior = getattr(self, kind)
            if prior is not None:
                priors.update({self._name(kind, c): prior for c in self.channels})
        if self.time_shift is not None:
            priors["time_shift"] = self.time_shift
        return priors

    def _name(self, kind: str, channel: str) -> str:
        return kind if len(self.channels) == 1 else f"{kind}_{channel}"

    def transmit(self, response: Any, unknown: Mapping[str, Any]) -> Any:
        """Turn a model's response into what the instrument would show, inside JAX.

        Parameters
        ----------
        response : jax.Array, shape (time, channel, run)
            The model's response.
        unknown : mapping of str to jax.Array (run,)
            The nuisances.

        Returns
        -------
        jax.Array, shape (time, channel, run)
            gain · M(t − time_shift) + offset.
        """
        from structid.device import jnp

        if self.time_shift is not None:
            response = _shifted(response, unknown["time_shift"] / self.record.dt)
        if self.gain is not None:
            response = response * jnp.stack([unknown[self._name("gain", c)] for c in self.channels])
        if self.offset is not None:
            response = response + jnp.stack([unknown[self._name("offset", c)] for c in self.channels])
        return response

    def describe(self) -> dict[str, Any]:
        """Return everything a posterior depends on, for hashes.

        Returns
        -------
        dict
            Hashes of record and values, channels and nuisances.
        """
        return {
            "record": self.record.content_hash,
            "values": digest(self.values),
            "channels": list(self.channels),
            "nuisances": {k: v.describe() for k, v in self.nuisances().items()},
        }


def _shifted(response: Any, samples: Any) -> Any:
    """M(t − τ) by cubic (Catmull-Rom) interpolation; the ends are held."""
    from structid.device import jnp

    last = response.shape[0] - 1
    position = jnp.arange(response.shape[0])[:, None] - samples[None, :]
    base = jnp.floor(position)
    f = (position - base)[:, None, :]

    def at(offset: int) -> Any:
        rows = jnp.clip(base.astype(int) + offset, 0, last)
        return jnp.take_along_axis(response, rows[:, None, :], axis=0)

    p0, p1, p2, p3 = at(-1), at(0), at(1), at(2)
    return p1 + 0.5 * f * (p2 - p0 + f * (2 * p0 - 5 * p1 + 4 * p2 - p3 + f * (3 * (p1 - p2) + p3 - p0)))


class Posterior(Target):
    """π(θ | y) ∝ π(θ) L(y | θ) for one or several measured histories that share the model's parameters.

    Parameters
    ----------
    space : ParameterSpace
        The model's unknown parameters and their priors.
    model : Model
        Any model: built in, external, or a surrogate.
    observations : Observation or sequence of Observation
        The measurements; each has its own discrepancy and nuisances, numbered ``_1``, ``_2``, … when there are several.
    discrepancy : Discrepancy
        The law of the difference between model and measurement.
    map : callable, optional
        Spreads the runs of an external model, like ``Executor.map``.
    refuse_unfit : bool
        Refuse a surrogate with an error past its limit.
    model_error : bool
        Add a surrogate's own variance to that of the discrepancy: where it is unsure, it then says less. That of a `PODKriging` or
        `PODPCE` of one channel is integrated out exactly where errors are independent; else its mean over time counts as white
        noise. Not for a surrogate that is unsure of large parts of the prior: where its variance is as large as the response it
        explains any measurement, and the posterior goes there.

    Attributes
    ----------
    names : tuple of str
        The model's parameters, then the nuisances, then the discrepancy's parameters.
    """

    def __init__(
        self,
        space: ParameterSpace,
        model: Model,
        observations: Observation | Sequence[Observation],
        discrepancy: Discrepancy | None = None,
        map: Map | None = None,
        refuse_unfit: bool = True,
        model_error: bool = False,
    ) -> None:
        self.model_error = model_error
        self.model_space, self.model, self.map = space, model, map
        self.observations = (observations,) if isinstance(observations, Observation) else tuple(observations)
        self.discrepancy = IID() if discrepancy is None else discrepancy
        if not self.observations:
            raise InputError("Posterior.observations", "none", "one Observation or more")
        model.check_names(space.names, space.all_names)
        if refuse_unfit:
            model.check_fitness()
        for observation in self.observations:
            check_channels("observation.channels", observation.channels, model.channels)
            model.check_excitation(observation.record)
        extra = {}
        for index, observation in enumerate(self.observations):
            own = observation.nuisances() | self.discrepancy.parameters(
                observation.values, observation.channels, observation.record.dt
            )
            extra.update({self._label(name, index): prior for name, prior in own.items()})
        self.space = space.extended(**extra)
        self.names = self.space.names
        self.bijection = self.space.bijection

    @property
    def knows_prior(self) -> bool:
        """Always: prior and likelihood can be told apart."""
        return True

    def traceable(self) -> tuple[Callable[[Any, Any], Any], Any]:
        """Give the density as a JAX function; see `Target.traceable`.

        Returns
        -------
        tuple of callable and tree of arrays
            The function, and records and measurements.
        """
        if not isinstance(self.model, JaxModel):
            return super().traceable()
        return lambda phi, data: self._in_coordinates(phi, data)[0], self.data

    def spread(self, map: Map | None) -> Posterior:
        """Return the same posterior with the runs of an external model spread by `map`.

        Parameters
        ----------
        map : callable or None
            Like ``Executor.map``.

        Returns
        -------
        Posterior
            The same densities.
        """
        return Posterior(
            self.model_space, self.model, self.observations, self.discrepancy, map, False, self.model_error
        )

    def on(self, model: Model, refuse_unfit: bool = True) -> Posterior:
        """Return the posterior of the same parameters and measurements on another model, such as a surrogate.

        Parameters
        ----------
        model : Model
            The model.
        refuse_unfit : bool
            Refuse a surrogate with an error past its limit.

        Returns
        -------
        Posterior
            With that model in the place of this one's.
        """
        return Posterior(
            self.model_space, model, self.observations, self.discrepancy, self.map, refuse_unfit, self.model_error
        )

    def _label(self, name: str, index: int) -> str:
        return name if len(self.observations) == 1 else f"{name}_{index + 1}"

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
        """Hash of prior, model, measurements and discrepancy."""
        described = [o.describe() for o in self.observations]
        parts = [self.space.content_hash, self.model.content_hash, described, self.discrepancy.describe()]
        return digest(*parts, *(["model error"] if self.model_error else []))

    def initial(self, count: int, rng: np.random.Generator) -> np.ndarray:
        """Draw starting points from the prior; see `Target.initial`.

        Parameters
        ----------
        count : int
            How many.
        rng : numpy.random.Generator
            Source of randomness.

        Returns
        -------
        ndarray, shape (count, parameter)
            In unconstrained coordinates.
        """
        return self.bijection.inverse(self.space.from_uniform(rng.random((count, self.dimension))))

    # --- pieces of the density, inside JAX ----------------------------------------------------------------------

    def unknowns(self, theta: Any, index: int) -> dict[str, Any]:
        """Nuisances and discrepancy parameters of one observation, by their plain names.

        Parameters
        ----------
        theta : array, shape (run, parameter)
            All parameters.
        index : int
            Which observation.

        Returns
        -------
        dict of str to array (run,)
            The values.
        """
        observation = self.observations[index]
        own = observation.nuisances() | self.discrepancy.parameters(
            observation.values, observation.channels, observation.record.dt
        )
        return {name: theta[:, self.names.index(self._label(name, index))] for name in own}

    def discrepancy_names(self, index: int) -> tuple[str, ...]:
        """Names of the discrepancy's parameters for one observation.

        Parameters
        ----------
        index : int
            Which observation.

        Returns
        -------
        tuple of str
            As they stand in `names`.
        """
        observation = self.observations[index]
        own = self.discrepancy.parameters(observation.values, observation.channels, observation.record.dt)
        return tuple(self._label(name, index) for name in own)

    def model_parameters(self, theta: Any) -> Any:
        """Columns of the model's free parameters.

        Parameters
        ----------
        theta : array, shape (run, parameter)
            All parameters.

        Returns
        -------
        array, shape (run, free parameter)
            In the model's order.
        """
        return self.space.columns(theta, self.model.free)

    def instrument(self, response: Any, theta: Any, index: int) -> Any:
        """Turn a model's response into what the instruments of one observation would show, inside JAX.

        Parameters
        ----------
        response : jax.Array, shape (time, model channel, run)
            The model's response.
        theta : jax.Array, shape (run, parameter)
            All parameters.
        index : int
            Which observation.

        Returns
        -------
        jax.Array, shape (time, channel, run)
            The measured channels, nuisances applied.
        """
        observation = self.observations[index]
        if self.model.channels != observation.channels:
            response = response[:, np.array([self.model.channels.index(c) for c in observation.channels])]
        return observation.transmit(response, self.unknowns(theta, index))

    def likelihood_given(self, response: Any, theta: Any, values: Any, index: int) -> Any:
        """Log-likelihood of one observation for responses that are there already, inside JAX.

        Parameters
        ----------
        response : jax.Array, shape (time, model channel, run)
            The model's response.
        theta : jax.Array, shape (run, parameter)
            All parameters.
        values : array, shape (time, channel, 1 or run)
            What was measured, the same for all runs or each its own.
        index : int
            Which observation.

        Returns
        -------
        jax.Array, shape (run,)
            The discrepancy's log density of the residuals.
        """
        residual = values - self.instrument(response, theta, index)
        observation = self.observations[index]
        unknown = self.unknowns(theta, index)
        return self.discrepancy.log_likelihood(residual, unknown, observation.channels, observation.record.dt)

    def _log_likelihood(self, theta: Any, data: Any) -> tuple[Any, Any]:
        """Log-likelihood and success of every run; `data` holds stages, values and reduction of each observation."""
        from structid.device import jnp

        assert isinstance(self.model, JaxModel)
        total, finite = jnp.zeros(theta.shape[0]), jnp.ones(theta.shape[0], dtype=bool)
        parameters = self.model_parameters(theta)
        for index, (stages, values, reduction) in enumerate(data):
            if self.model_error:
                more, good = self._with_model_error(theta, parameters, stages, values, reduction, index)
            elif reduction is not None and self._needs_only_squares(index):
                more, good = self._by_squares(theta, parameters, reduction, index)
            else:
                response, good = self.model.response(parameters, self.observations[index].record, stages)
                more = self.likelihood_given(response, theta, values[:, :, None], index)
            total, finite = total + more, finite & good
        finite = finite & jnp.isfinite(total)
        return total, finite

    def _with_model_error(
        self, theta: Any, parameters: Any, stages: Any, values: Any, reduction: Any, index: int
    ) -> tuple[Any, Any]:
        """Log-likelihood with the model's own variance added to that of the discrepancy."""
        from structid.device import jnp

        assert isinstance(self.model, JaxModel)
        observation, unknown, law = self.observations[index], self.unknowns(theta, index), self.discrepancy
        record, channels = observation.record, observation.channels
        if isinstance(law, IID) and not observation.nuisances() and reduction is not None:
            variance = law.variances(unknown, channels, theta.shape[0], jnp)
            exact = self.model.marginal_log_likelihood(parameters, record, reduction, variance)
            if exact is not None:
                return exact
        response, good = self.model.response(parameters, record, stages)
        places = np.array([self.model.channels.index(c) for c in channels])
        white = self.model.error_variance(parameters, record, response)[places]
        residual = values[:, :, None] - self.instrument(response, theta, index)
        return law.log_likelihood(residual, unknown, channels, record.dt, white), good

    def _needs_only_squares(self, index: int) -> bool:
        """Whether discrepancy and instrument of an observation ask for no more than a sum of squares."""
        return self.discrepancy.sees_only_squares and not self.observations[index].nuisances()

    def _by_squares(self, theta: Any, parameters: Any, reduction: Any, index: int) -> tuple[Any, Any]:
        """Log-likelihood by the sum of squares alone, of a model that has a shorter way to it than the response."""
        observation = self.observations[index]
        assert isinstance(self.model, JaxModel)
        squares, finite = self.model.squared_misfit(parameters, observation.record, reduction)
        unknown, samples = self.unknowns(theta, index), len(observation.values)
        return self.discrepancy.log_likelihood_of_squares(squares, samples, unknown, observation.channels), finite

    def _log_density(self, theta: Any, data: Any) -> tuple[Any, Any, Any]:
        from structid.device import jnp

        likelihood, finite = self._log_likelihood(theta, data)
        prior = self.space.jax_log_density(theta)
        inside = jnp.isfinite(prior)
        density = jnp.where(finite & inside, prior + likelihood, -jnp.inf)
        return density, jnp.where(finite & inside, likelihood, -jnp.inf), inside & ~finite

    @cached_property
    def data(self) -> list[tuple[np.ndarray, np.ndarray, Any]]:
        """Of each observation, as the density takes them inside JAX: stages of the record, measured values, and their reduction.

        The reduction is what a model with a shorter way to a misfit than its response needs of the values; None for others.
        """
        model = self.model
        assert isinstance(model, JaxModel)
        return [
            (o.record.stage_values(model.substeps), o.values, model.reduction(o.record, o.values, o.channels))
            for o in self.observations
        ]

    def _in_coordinates(self, phi: Any, data: Any) -> tuple[Any, Any]:
        theta, jacobian = self.bijection.forward(phi)
        density, _, failed = self._log_density(theta, data)
        return density + jacobian, failed

    def _parts_in_coordinates(self, phi: Any, data: Any) -> tuple[Any, Any, Any]:
        theta, jacobian = self.bijection.forward(phi)
        _, likelihood, failed = self._log_density(theta, data)
        return self.space.jax_log_density(theta) + jacobian, likelihood, failed

    @cached_property
    def _compiled(self) -> dict[str, Callable[..., Any]]:
        from structid.device import over_runs

        assert isinstance(self.model, JaxModel)
        spread = self.model.loops or not self.discrepancy.sees_only_squares  # correlated errors are a loop, too
        return {
            "density": over_runs(self._log_density, spread=spread),
            "coordinates": over_runs(self._in_coordinates, spread=spread),
            "parts": over_runs(self._parts_in_coordinates, spread=spread),
        }

    # --- densities on the host ----------------------------------------------------------------------------------

    def _evaluate(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Log density, log-likelihood and failure of every run."""
        theta = self._points(theta)
        if isinstance(self.model, JaxModel):
            parts = [self._compiled["density"](theta[rows], self.data) for rows in batches(len(theta))]
            density, likelihood, failed = (np.concatenate(column) for column in zip(*parts, strict=True))
            return density, likelihood, failed
        prior = self.space.log_density(theta)
        likelihood, failed = np.full(len(theta), -np.inf), np.zeros(len(theta), dtype=bool)
        rows = np.flatnonzero(np.isfinite(prior))
        if rows.size:
            likelihood[rows], failed[rows] = self._host_log_likelihood(theta[rows])
        return prior + likelihood, likelihood, failed

    def _host_log_likelihood(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        total, failed = np.zeros(len(theta)), np.zeros(len(theta), dtype=bool)
        parameters = np.asarray(self.model_parameters(theta))
        for index, observation in enumerate(self.observations):
            run = self.model.simulate(parameters, observation.record, map=self.map)
            failed |= ~run.done
            response = np.where(run.done[:, None, None], run.values, 0.0).transpose(1, 2, 0)
            total += np.asarray(self.likelihood_given(response, theta, observation.values[:, :, None], index))
        return np.where(failed, -np.inf, total), failed

    def _points(self, theta: np.ndarray) -> np.ndarray:
        theta = np.atleast_2d(np.asarray(theta, dtype=np.float64))
        if theta.shape[1] != self.dimension:
            raise InputError(
                "theta",
                f"an array of shape {theta.shape}",
                f"(run, {self.dimension}) with the columns {', '.join(self.names)}",
            )
        return theta

    def log_density(self, theta: np.ndarray) -> np.ndarray:
        """Unnormalised log posterior density; see `Target.log_density`.

        Parameters
        ----------
        theta : ndarray, shape (run, parameter)
            Parameters in SI.

        Returns
        -------
        ndarray, shape (run,)
            −inf outside the support and where the simulation failed.
        """
        return self._evaluate(theta)[0]

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
        """Log density in unconstrained coordinates; see `Target.evaluate`.

        Parameters
        ----------
        phi : ndarray, shape (run, parameter)
            Unconstrained coordinates.

        Returns
        -------
        tuple of ndarray, shape (run,)
            Log density with respect to φ, and where a simulation failed.
        """
        if isinstance(self.model, JaxModel):
            parts = [self._compiled["coordinates"](phi[rows], self.data) for rows in batches(len(phi))]
            return np.concatenate([p[0] for p in parts]), np.concatenate([p[1] for p in parts])
        theta, jacobian = self.bijection(phi)
        density, _, failed = self._evaluate(theta)
        return density + jacobian, failed

    def evaluate_parts(self, phi: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Prior and likelihood apart; see `Target.evaluate_parts`.

        Parameters
        ----------
        phi : ndarray, shape (run, parameter)
            Unconstrained coordinates.

        Returns
        -------
        tuple of ndarray, shape (run,)
            Log prior with respect to φ, log-likelihood, and where a simulation failed.
        """
        if isinstance(self.model, JaxModel):
            parts = [self._compiled["parts"](phi[rows], self.data) for rows in batches(len(phi))]
            prior, likelihood, failed = (np.concatenate(column) for column in zip(*parts, strict=True))
            return prior, likelihood, failed
        theta, jacobian = self.bijection(phi)
        _, likelihood, failed = self._evaluate(theta)
        return self.space.log_density(theta) + jacobian, likelihood, failed

    def given(self, responses: Sequence[np.ndarray]) -> GivenResponses:
        """Put responses that are already there, such as the runs of a campaign, in the place of the model's.

        Parameters
        ----------
        responses : sequence of ndarray, shape (run, time, channel)
            The model's response to the record of each observation, in the model's channels; NaN where it failed.

        Returns
        -------
        GivenResponses
            Log densities of parameters, a row for each run.
        """
        return GivenResponses(self, responses)

    def predict(self, theta: np.ndarray, index: int = 0, progress: Progress | None = None) -> np.ndarray:
        """Prediction of one observation, instrument included, without discrepancy.

        Parameters
        ----------
        theta : ndarray, shape (run, parameter)
            Parameters in SI.
        index : int
            Which observation.
        progress : callable, optional
            Told how many runs are done.

        Returns
        -------
        ndarray, shape (run, time, channel)
            In SI; NaN where a run failed.
        """
        theta = self._points(theta)
        observation = self.observations[index]
        parameters = np.asarray(self.model_parameters(theta))
        run = self.model.simulate(parameters, observation.record, progress=progress, map=self.map)
        return np.asarray(self.instrument(run.values.transpose(1, 2, 0), theta, index)).transpose(2, 0, 1)

    def pointwise_log_likelihood(self, theta: np.ndarray, index: int = 0) -> np.ndarray:
        """Log-likelihood of every observation.

        Parameters
        ----------
        theta : ndarray, shape (run, parameter)
            Parameters in SI.
        index : int
            Which observation.

        Returns
        -------
        ndarray, shape (run, time, channel)
            Log densities.
        """
        theta = self._points(theta)
        observation = self.observations[index]
        residual = (observation.values - self.predict(theta, index)).transpose(1, 2, 0)
        unknown, dt = self.unknowns(theta, index), observation.record.dt
        pointwise = self.discrepancy.pointwise(residual, unknown, observation.channels, dt)
        return np.asarray(pointwise).transpose(2, 0, 1)

    # --- deterministic misfit -----------------------------------------------------------------------------------

    @cached_property
    def misfit(self) -> Any:
        """The sum of squared residuals J(θ) [3.22] of the model's parameters; see `Misfit`."""
        return Misfit(self)

    def design(self, theta: np.ndarray) -> Design:
        """Give rows of parameters their names.

        Parameters
        ----------
        theta : ndarray, shape (run, parameter)
            Parameters in SI.

        Returns
        -------
        Design
            The same, with the posterior's space.
        """
        return Design(self._points(theta), self.space)


class GivenResponses:
    """A posterior whose model has been run already.

    Parameters
    ----------
    posterior : Posterior
        The posterior.
    responses : sequence of ndarray, shape (run, time, channel)
        The model's response to the record of each observation; NaN where it failed.
    """

    def __init__(self, posterior: Posterior, responses: Sequence[np.ndarray]) -> None:
        self._posterior = posterior
        self._finite = np.asarray(np.stack([np.isfinite(r).all(axis=(1, 2)) for r in responses]).all(axis=0))
        self._responses = [np.where(self._finite[:, None, None], r, 0.0).transpose(1, 2, 0) for r in responses]
        self._squares = [self._sum_of_squares(i) for i in range(len(responses))]

    def _sum_of_squares(self, index: int) -> np.ndarray | None:
        """Σ (y − M)² (channel, run), where the likelihood sees no more."""
        p, observation = self._posterior, self._posterior.observations[index]
        if not p.discrepancy.sees_only_squares or observation.nuisances():
            return None
        channels = [p.model.channels.index(c) for c in observation.channels]
        residual = observation.values[:, :, None] - self._responses[index][:, channels]
        return np.asarray(np.einsum("tcr,tcr->cr", residual, residual))

    def log_density(self, theta: np.ndarray) -> np.ndarray:
        """Log posterior density.

        Parameters
        ----------
        theta : ndarray, shape (run, parameter)
            Parameters in SI, a row for each run.

        Returns
        -------
        ndarray, shape (run,)
            −inf outside the support and where a response is not finite.
        """
        p = self._posterior
        theta = p._points(theta)
        total = p.space.log_density(theta)
        for index, (observation, response) in enumerate(zip(p.observations, self._responses, strict=True)):
            squares, samples = self._squares[index], len(observation.values)
            if squares is not None:
                own = p.unknowns(theta, index)
                found = p.discrepancy.log_likelihood_of_squares(squares, samples, own, observation.channels)
            else:
                found = p.likelihood_given(response, theta, observation.values[:, :, None], index)
            total = total + np.asarray(found)
        return np.where(self._finite & ~np.isnan(total), total, -np.inf)


class Misfit:
    """J(θ) = Σ (y − M(θ))² [3.22] over the model's own parameters, nuisances at their prior medians.

    Channels of different units are each divided by Σ y² so that they may be added; with a single channel nothing is divided.

    Parameters
    ----------
    posterior : Posterior
        Where model, measurements and space come from.
    """

    def __init__(self, posterior: Posterior) -> None:
        self.space = posterior.model_space
        self.names = self.space.names
        self._posterior = posterior
        extra = list(posterior.space.marginals.values())[self.space.dimension :]
        self._rest = np.array([float(m.quantile(np.array(0.5))) for m in extra])

    @property
    def differentiable(self) -> bool:
        """Whether the model has derivatives."""
        return isinstance(self._posterior.model, JaxModel)

    @cached_property
    def scale(self) -> float:
        """Σ y² over every measurement, in the units of J."""
        return float(
            sum((o.values**2 * w).sum() for o, w in zip(self._posterior.observations, self._weights, strict=True))
        )

    @cached_property
    def _weights(self) -> list[np.ndarray]:
        observations = self._posterior.observations
        if all(len(o.channels) == 1 for o in observations) and len({o.channels for o in observations}) == 1:
            return [np.ones(1) for _ in observations]
        return [1.0 / (o.values**2).sum(axis=0) for o in observations]

    def _with_rest(self, theta: Any) -> Any:
        """All parameters of the posterior, inside JAX: the model's, and the others as they are held."""
        from structid.device import jnp

        return jnp.concatenate([theta, jnp.broadcast_to(self._rest, (theta.shape[0], self._rest.size))], axis=1)

    def _residuals(self, theta: Any, data: Any) -> Any:
        """All weighted residuals of every run, (residual, run)."""
        from structid.device import jnp

        p = self._posterior
        assert isinstance(p.model, JaxModel)
        full, parts = self._with_rest(theta), []
        for index, (stages, values, _) in enumerate(data):
            response, _ = p.model.response(p.model_parameters(full), p.observations[index].record, stages)
            residual = (values[:, :, None] - p.instrument(response, full, index)) * np.sqrt(self._weights[index])[
                :, None
            ]
            parts.append(residual.reshape(-1, theta.shape[0]))
        return jnp.concatenate(parts)

    def _by_squares(self, theta: Any, data: Any) -> Any:
        """J(θ) of a model that has a shorter way to it than the residuals, shape (run,); None where there is none."""
        from structid.device import jnp

        p = self._posterior
        assert isinstance(p.model, JaxModel)
        if any(reduction is None for *_, reduction in data) or any(o.nuisances() for o in p.observations):
            return None
        full, total = self._with_rest(theta), jnp.zeros(theta.shape[0])
        for (*_, reduction), observation, weights in zip(data, p.observations, self._weights, strict=True):
            squares, finite = p.model.squared_misfit(p.model_parameters(full), observation.record, reduction)
            total = total + jnp.where(finite, weights @ squares, jnp.inf)
        return total

    @cached_property
    def _compiled(self) -> dict[str, Callable[..., Any]]:
        import jax

        from structid.device import jnp, over_runs

        def value(theta: Any, data: Any) -> Any:
            short = self._by_squares(theta, data)
            return (self._residuals(theta, data) ** 2).sum(axis=0) if short is None else short

        def linearised(theta: Any, data: Any) -> tuple[Any, Any, Any]:
            # Forward mode: few parameters, long histories. One tangent a parameter, all runs at once.
            def pushed(direction: Any) -> Any:
                tangent = jnp.broadcast_to(direction, theta.shape)
                return jax.jvp(lambda t: self._residuals(t, data), (theta,), (tangent,))

            residual, jacobian = jax.vmap(pushed, out_axes=(None, 0))(jnp.eye(theta.shape[1]))
            gradient = 2.0 * jnp.einsum("tb,ptb->bp", residual, jacobian)
            return (residual**2).sum(axis=0), gradient, 2.0 * jnp.einsum("ptb,qtb->bpq", jacobian, jacobian)

        return {"value": over_runs(value), "linearised": over_runs(linearised)}

    def __call__(self, theta: np.ndarray) -> np.ndarray:
        """Misfit.

        Parameters
        ----------
        theta : ndarray, shape (run, parameter)
            The model's parameters in SI.

        Returns
        -------
        ndarray, shape (run,)
            J; +inf where the simulation failed.
        """
        theta = np.atleast_2d(np.asarray(theta, dtype=np.float64))
        p = self._posterior
        if isinstance(p.model, JaxModel):
            value = np.concatenate([self._compiled["value"](theta[rows], p.data) for rows in batches(len(theta))])
        else:
            full = np.concatenate([theta, np.tile(self._rest, (len(theta), 1))], axis=1)
            value = sum(
                (((o.values - p.predict(full, i)) ** 2) * self._weights[i]).sum(axis=(1, 2))
                for i, o in enumerate(p.observations)
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
            If the model is not one of structid's own and has no derivatives.
        """
        theta = np.atleast_2d(np.asarray(theta, dtype=np.float64))
        if not isinstance(self._posterior.model, JaxModel):
            raise InputError(
                "misfit gradient",
                f"a {type(self._posterior.model).__name__}, which has no derivatives",
                "a built-in model or a surrogate",
                "Use pattern search, which needs none.",
            )
        parts = [self._compiled["linearised"](theta[rows], self._posterior.data) for rows in batches(len(theta), 64)]
        value, gradient, hessian = (np.concatenate(column) for column in zip(*parts, strict=True))
        return value, gradient, hessian


def batches(count: int, size: int = LARGEST_BATCH) -> list[slice]:
    """Cut a number of runs into batches.

    Parameters
    ----------
    count : int
        Runs.
    size : int
        Of a batch at most.

    Returns
    -------
    list of slice
        One after another.
    """
    return [slice(start, min(start + size, count)) for start in range(0, count, size)]
