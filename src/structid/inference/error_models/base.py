"""The interface of error models: the difference between model and measurement as a random process, y = M(θ) + ε."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Float

from structid.core.arrays import Array
from structid.engine.time_loop import Fold
from structid.models.base import Model
from structid.probability.space import ParameterSpace
from structid.probability.truncation import Marginal


class ErrorModel(ABC):
    """What may be wrong between model and measurement: errors inside the model, and errors ε added to its response."""

    @property
    @abstractmethod
    def added(self) -> Discrepancy:
        """The error model of ε, added to the response."""

    @property
    def inside(self) -> bool:
        """Whether there are errors inside the model, too."""
        return self.added is not self

    def among(self, space: ParameterSpace, duration: float) -> ErrorModel:
        """Return the error model for a model with these unknown parameters.

        Parameters
        ----------
        space : ParameterSpace
            The model's parameters and their priors.
        duration : float
            Of the first record [s].

        Returns
        -------
        ErrorModel
            The same one, where it does not depend on them.
        """
        return self

    @property
    def shared_parameters(self) -> dict[str, Marginal]:
        """Additional parameters shared by all observations, and their priors."""
        return {}

    def hidden_parameters(self, duration: float) -> dict[str, Marginal]:
        """Values inside the model that each observation has for itself: sampled, but of no interest by themselves.

        Parameters
        ----------
        duration : float
            Of its record [s].

        Returns
        -------
        dict of str to Marginal
            Their priors.
        """
        return {}

    def scatters(self, duration: float) -> dict[tuple[str, str], tuple[str, ...]]:
        """Hidden values that scatter about a parameter.

        Parameters
        ----------
        duration : float
            Of the record [s].

        Returns
        -------
        dict of pair of str to tuple of str
            For the names of a mean and a standard deviation those of the hidden values, which are standardised.
        """
        return {}

    def responding(self, model: Model, duration: float) -> Model:
        """Return the model with the errors inside.

        Parameters
        ----------
        model : Model
            The model.
        duration : float
            Of the record that drives it [s].

        Returns
        -------
        Model
            The same, where no errors are inside.
        """
        return model

    @abstractmethod
    def describe(self) -> dict[str, Any]:
        """Return everything that defines the error model, for hashes and reports."""


class Discrepancy(ErrorModel):
    """An error model for ε, added to the response, with parameters of its own, which are inferred with the model's.

    Examples
    --------
    `tests/architecture/trial/new_discrepancy.py` is a complete one, with Laplace's density.

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
        """The part of ε that may be the model's own error, i.e. what is correlated in time; None if nothing is."""
        return None

    independent: ClassVar[bool] = False
    """Whether errors are independent and normal: the likelihood then needs only the residual's sum of squares over time."""

    def log_likelihood_of_squares(
        self, squares: Float[Array, "channel run"], samples: int, unknown: Mapping[str, Any], channels: tuple[str, ...]
    ) -> Float[Array, " run"]:
        """Log density of a residual from its sum of squares, inside JAX; for error models that need only that.

        Parameters
        ----------
        squares : jax.Array, shape (channel, run)
            Sum over time of the squared residual.
        samples : int
            How many were summed.
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
        self, unknown: Mapping[str, Any], channels: tuple[str, ...], runs: int, dt: float, samples: int
    ) -> Fold | None:
        """Give the log density of a residual as a fold over its samples, inside JAX, for an error model that has one.

        Parameters
        ----------
        unknown : mapping of str to jax.Array (run,)
            The unknown parameters.
        channels : tuple of str
            Names of the channels.
        runs : int
            How many.
        dt : float
            Time step [s].
        samples : int
            Length of the residual.

        Returns
        -------
        Fold or None
            Of samples (channel, run) to the log-likelihood (run,); None for an error model that needs the whole residual.
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
            How many runs.
        numpy : module
            ``numpy``, or ``jax.numpy`` inside JAX.

        Returns
        -------
        array, shape (channel, run)
            In the square of each channel's SI unit.
        """
        raise NotImplementedError(f"{type(self).__name__} has no independent errors")

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
            SI unit of each channel, empty where it is not known.

        Returns
        -------
        dict of str to Marginal
            Empty if everything is known.
        """

    @abstractmethod
    def log_likelihood(
        self,
        residual: Float[Array, "time channel run"],
        unknown: Mapping[str, Any],
        channels: tuple[str, ...],
        dt: float,
        white: Any = 0.0,
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
            Further variance of independent errors, such as a surrogate's.

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
    ) -> Float[Array, "time channel run"]:
        """Log density of every observation given those before it, inside JAX.

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
    ) -> Float[Array, "time channel run"]:
        """Linear map of a residual to independent unit normals, inside JAX.

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

        Returns
        -------
        jax.Array, shape (time, channel, run)
            L⁻¹ r with L Lᵀ the covariance of ε.
        """

    @abstractmethod
    def draw(
        self,
        rng: np.random.Generator,
        shape: tuple[int, int, int],
        unknown: Mapping[str, np.ndarray],
        channels: tuple[str, ...],
        dt: float,
    ) -> Float[np.ndarray, "run time channel"]:
        """Draw ε.

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
