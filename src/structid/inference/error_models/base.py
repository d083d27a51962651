"""The interface of error models: the difference between model and measurement as a random process, y = M(θ) + ε."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from structid.core.arrays import Array
from structid.engine.time_loop import Fold
from structid.models.base import Model
from structid.probability.space import ParameterSpace
from structid.probability.truncation import Marginal


class ErrorModel(ABC):
    """Errors between model and measurement: errors inside the model, and errors ε added to its response."""

    @property
    @abstractmethod
    def added(self) -> Discrepancy:
        """The error model of ε, added to the response."""

    @property
    def inside(self) -> bool:
        """Whether there are also errors inside the model."""
        return self.added is not self

    def among(self, space: ParameterSpace, duration: float) -> ErrorModel:
        """Return the error model for a model with these unknown parameters.

        Parameters
        ----------
        space : ParameterSpace
            The model's parameters and their priors.
        duration : float
            Duration of the first record [s].

        Returns
        -------
        ErrorModel
            This error model itself if it does not depend on the parameters.
        """
        return self

    @property
    def shared_parameters(self) -> dict[str, Marginal]:
        """Additional parameters shared by all observations, and their priors."""
        return {}

    def hidden_parameters(self, duration: float) -> dict[str, Marginal]:
        """Latent values inside the model, separate for each observation; they are sampled, but results omit them.

        Parameters
        ----------
        duration : float
            Duration of the observation's record [s].

        Returns
        -------
        dict of str to Marginal
            Prior of each latent value.
        """
        return {}

    def scatters(self, duration: float) -> dict[tuple[str, str], tuple[str, ...]]:
        """Hidden values that scatter about a parameter.

        Parameters
        ----------
        duration : float
            Duration of the record [s].

        Returns
        -------
        dict of pair of str to tuple of str
            Names of the hidden values, which are standardised, by the names of their mean and standard deviation.
        """
        return {}

    def responding(self, model: Model, duration: float) -> Model:
        """Return the model with the errors inside it.

        Parameters
        ----------
        model : Model
            The model.
        duration : float
            Duration of the driving record [s].

        Returns
        -------
        Model
            The model itself if no errors are inside it.
        """
        return model

    @abstractmethod
    def describe(self) -> dict[str, Any]:
        """Return everything that defines the error model, for hashes and reports."""


class ResidualSample(NamedTuple):
    """What an error model sees of the samples of an observation: all of them, with a first axis of time, or one of them."""

    residual: Any  # measurement minus response (…, channel, run)
    is_measured: Any = None  # mask of the measured values (…, channel, 1); None if no value is missing
    response: Any = None  # the response (…, channel, run); None if the error model does not depend on it


class Discrepancy(ErrorModel):
    """Error model of ε, which is added to the response; its parameters are inferred together with the model's.

    Examples
    --------
    `tests/architecture/trial/new_discrepancy.py` is a complete example, with Laplace's density.

    >>> import numpy as np
    >>> import structid as si
    >>> errors = si.IID(variance=4.0)
    >>> residual = np.array([[[2.0]], [[0.0]]])  # two samples of one channel of one run
    >>> float(errors.log_likelihood(residual, {}, ("displacement",), 0.01)[0]).__round__(4)
    -3.7242
    """

    @property
    def added(self) -> Discrepancy:
        """Itself."""
        return self

    @property
    def of_the_model(self) -> Discrepancy | None:
        """The part of ε that is correlated in time and may be the model's error; None if no part is."""
        return None

    independent: ClassVar[bool] = False
    """Whether errors are independent and normal: the likelihood then needs only the residual's sum of squares over time."""

    takes_gaps: ClassVar[bool] = False
    """Whether the methods accept `is_measured`, a mask of the measured values; without it, values must not be missing."""

    has_outliers: ClassVar[bool] = False
    """Whether a few errors may be much larger than the others."""

    depends_on_response: ClassVar[bool] = False
    """Whether the errors depend on the response: the methods then have the further argument `response`, in the residual's shape."""

    def seeing(self, response: Any) -> dict[str, Any]:
        """Return the response as an argument of the methods, if the error model depends on it.

        Parameters
        ----------
        response : array
            Response, divided by the known standard deviations if the observation has some.

        Returns
        -------
        dict
            Keyword arguments.
        """
        return {"response": response} if self.depends_on_response else {}

    def bound_to(self, values: Float[np.ndarray, "time channel"], channels: tuple[str, ...]) -> Discrepancy:
        """Return the error model of one observation, with what it takes from the measured values.

        Parameters
        ----------
        values : ndarray, shape (time, channel)
            The measurement in SI, divided by the known standard deviations if there are some; NaN for a missing value.
        channels : tuple of str
            Names of its channels.

        Returns
        -------
        Discrepancy
            This error model itself if it takes nothing from the values.
        """
        return self

    def log_likelihood_of_squares(
        self, squares: Float[Array, "channel run"], samples: Any, unknown: Mapping[str, Any], channels: tuple[str, ...]
    ) -> Float[Array, " run"]:
        """Log density of a residual from its sum of squares, inside JAX; for independent normal errors.

        Parameters
        ----------
        squares : jax.Array, shape (channel, run)
            Sum over time of the squared residual.
        samples : int or array, shape (channel, 1)
            Number of summed samples.
        unknown : mapping of str to jax.Array (run,)
            The unknown parameters.
        channels : tuple of str
            Names of the channels.

        Returns
        -------
        jax.Array, shape (run,)
            The log-likelihood.
        """
        raise NotImplementedError(f"{type(self).__name__} needs the whole residual")

    def fold(
        self,
        unknown: Mapping[str, Any],
        channels: tuple[str, ...],
        runs: int,
        dt: float,
        samples: Any,
    ) -> Fold | None:
        """Return the log density of a residual as a fold over its samples, inside JAX, if the error model has one.

        Parameters
        ----------
        unknown : mapping of str to jax.Array (run,)
            The unknown parameters.
        channels : tuple of str
            Names of the channels.
        runs : int
            Number of runs.
        dt : float
            Time step [s].
        samples : int or array, shape (channel, 1)
            Number of measured values.

        Returns
        -------
        Fold or None
            Fold from `ResidualSample` to the log-likelihood (run,); None if the whole residual is needed.
        """
        return None

    def variances(
        self, unknown: Mapping[str, Any], channels: tuple[str, ...], runs: int, numpy: Any
    ) -> Float[Array, "channel run"]:
        """σ² of every channel and run; for error models with independent errors.

        Parameters
        ----------
        unknown : mapping of str to array (run,)
            The unknown parameters.
        channels : tuple of str
            Names of the channels.
        runs : int
            Number of runs.
        numpy : module
            ``numpy``, or ``jax.numpy`` inside JAX.

        Returns
        -------
        array, shape (channel, run)
            Variances in the square of each channel's SI unit.
        """
        raise NotImplementedError(f"{type(self).__name__} has no independent errors")

    def rounding(self, channels: tuple[str, ...]) -> Float[np.ndarray, " channel"]:
        """Step to which the values of every channel are rounded; 0 if they are not.

        Parameters
        ----------
        channels : tuple of str
            Names of the channels.

        Returns
        -------
        ndarray, shape (channel,)
            Steps in the channels' SI units.
        """
        return np.zeros(len(channels))

    @abstractmethod
    def parameters(
        self, values: Float[np.ndarray, "time channel"], channels: tuple[str, ...], dt: float, units: tuple[str, ...]
    ) -> dict[str, Marginal]:
        """Unknown parameters of ε and their priors.

        Parameters
        ----------
        values : ndarray, shape (time, channel)
            The measurement.
        channels : tuple of str
            Names of its channels.
        dt : float
            Its time step [s].
        units : tuple of str
            SI unit of each channel, empty if unknown.

        Returns
        -------
        dict of str to Marginal
            Empty if all parameters are known.
        """

    @abstractmethod
    def log_likelihood(
        self,
        residual: Float[Array, "time channel run"],
        unknown: Mapping[str, Any],
        channels: tuple[str, ...],
        dt: float,
        white: Any = 0.0,
        is_measured: Bool[np.ndarray, "time channel"] | None = None,
    ) -> Float[Array, " run"]:
        """Log density of the whole residual, inside JAX.

        Parameters
        ----------
        residual : jax.Array, shape (time, channel, run)
            Measurement minus prediction.
        unknown : mapping of str to jax.Array (run,)
            The unknown parameters.
        channels : tuple of str
            Names of the channels.
        dt : float
            Time step [s].
        white : jax.Array (channel, run) or float
            Additional variance of independent errors, such as a surrogate's error variance.
        is_measured : ndarray of bool, shape (time, channel), optional
            Mask of the measured values, if some are missing; the residual is 0 where a value is missing.

        Returns
        -------
        jax.Array, shape (run,)
            The log-likelihood.
        """

    @abstractmethod
    def pointwise(
        self,
        residual: Float[Array, "time channel run"],
        unknown: Mapping[str, Any],
        channels: tuple[str, ...],
        dt: float,
        is_measured: Bool[np.ndarray, "time channel"] | None = None,
    ) -> Float[Array, "time channel run"]:
        """Log density of every observed value given the earlier values, inside JAX.

        Parameters
        ----------
        residual : jax.Array, shape (time, channel, run)
            Measurement minus prediction.
        unknown : mapping of str to jax.Array (run,)
            The unknown parameters.
        channels : tuple of str
            Names of the channels.
        dt : float
            Time step [s].
        is_measured : ndarray of bool, shape (time, channel), optional
            Mask of the measured values, if some are missing; the result is 0 where a value is missing.

        Returns
        -------
        jax.Array, shape (time, channel, run)
            Its sum over time and channel is the log-likelihood.
        """

    @abstractmethod
    def whiten(
        self,
        residual: Float[Array, "time channel run"],
        unknown: Mapping[str, Any],
        channels: tuple[str, ...],
        dt: float,
        is_measured: Bool[np.ndarray, "time channel"] | None = None,
    ) -> Float[Array, "time channel run"]:
        """Linear map of a residual to independent errors with unit Fisher information, unit normals if ε is normal, inside JAX.

        Parameters
        ----------
        residual : jax.Array, shape (time, channel, run)
            Measurement minus prediction, or a sensitivity.
        unknown : mapping of str to jax.Array (run,)
            The unknown parameters.
        channels : tuple of str
            Names of the channels.
        dt : float
            Time step [s].
        is_measured : ndarray of bool, shape (time, channel), optional
            Mask of the measured values, if some are missing; the result is 0 where a value is missing.

        Returns
        -------
        jax.Array, shape (time, channel, run)
            L⁻¹ r with L Lᵀ the covariance of ε.
        """

    def influence(
        self,
        residual: Float[Array, "time channel run"],
        unknown: Mapping[str, Any],
        channels: tuple[str, ...],
        dt: float,
        **more: Any,
    ) -> Float[Array, "time channel run"]:
        """Influence of every value on the response: the gradient of log p by M is the transposed whitening of this.

        Parameters
        ----------
        residual : array, shape (time, channel, run)
            Measurement minus prediction.
        unknown : mapping of str to array (run,)
            The unknown parameters.
        channels : tuple of str
            Names of the channels.
        dt : float
            Time step [s].
        **more
            Mask of the measured values and response, as in `whiten`.

        Returns
        -------
        array, shape (time, channel, run)
            The same as `whiten` for normal errors; bounded for errors with outliers.
        """
        return self.whiten(residual, unknown, channels, dt, **more)

    def normal_scores(
        self,
        residual: Float[Array, "time channel run"],
        unknown: Mapping[str, Any],
        channels: tuple[str, ...],
        dt: float,
        **more: Any,
    ) -> Float[Array, "time channel run"]:
        """Map a residual to independent unit normals, by the distribution functions of its values.

        Parameters
        ----------
        residual : array, shape (time, channel, run)
            Measurement minus prediction.
        unknown : mapping of str to array (run,)
            The unknown parameters.
        channels : tuple of str
            Names of the channels.
        dt : float
            Time step [s].
        **more
            Mask of the measured values and response, as in `whiten`.

        Returns
        -------
        array, shape (time, channel, run)
            The same as `whiten` for normal errors.
        """
        return self.whiten(residual, unknown, channels, dt, **more)

    @abstractmethod
    def draw(
        self,
        rng: np.random.Generator,
        shape: tuple[int, int, int],
        unknown: Mapping[str, np.ndarray],
        channels: tuple[str, ...],
        dt: float,
    ) -> Float[np.ndarray, "run time channel"]:
        """Draw errors ε.

        Parameters
        ----------
        rng : numpy.random.Generator
            Source of randomness.
        shape : tuple of int
            (run, time, channel).
        unknown : mapping of str to ndarray (run,)
            The unknown parameters.
        channels : tuple of str
            Names of the channels.
        dt : float
            Time step [s].

        Returns
        -------
        ndarray, shape (run, time, channel)
            ε in SI.
        """
