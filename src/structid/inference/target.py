"""Targets of sampling: a log density over named parameters with a map to unconstrained coordinates."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any

import jax
import numpy as np
from jaxtyping import Float

from structid.core.errors import InputError, check_choice
from structid.core.hashing import digest, function_identity
from structid.core.validation import check_arguments, real_array
from structid.engine.device import over_runs
from structid.probability.bijections import Bijection
from structid.probability.space import ParameterSpace


class Target(ABC):
    """A log density in unconstrained coordinates φ, with a map to the user's parameters θ."""

    names: tuple[str, ...]
    bijection: Bijection

    def __str__(self) -> str:
        return f"{type(self).__name__} of {', '.join(self.names)}"

    def __repr__(self) -> str:
        return f"<{self}>"

    @property
    def dimension(self) -> int:
        """Number of parameters."""
        return len(self.names)

    @property
    def factors(self) -> np.ndarray:
        """SI value of one display unit, shape (parameter,)."""
        return np.ones(self.dimension)

    @property
    def units(self) -> dict[str, str]:
        """Display unit of every parameter."""
        return dict.fromkeys(self.names, "")

    @property
    def hidden(self) -> frozenset[str]:
        """Latent parameters, which tables and figures omit."""
        return frozenset()

    @property
    def shown(self) -> list[int]:
        """Indices of the parameters that tables and figures show."""
        return [index for index, name in enumerate(self.names) if name not in self.hidden]

    @cached_property
    def own(self) -> list[int]:
        """Indices of the parameters named by the user, without those of the error model."""
        return list(range(self.dimension))

    @property
    def variances(self) -> frozenset[str]:
        """Parameters that are error variances."""
        return frozenset()

    @property
    def sd_units(self) -> dict[str, str]:
        """Display unit of the square root of each error variance."""
        return {}

    @property
    def compared_names(self) -> tuple[str, ...]:
        """Names of the quantities whose moments are compared; see `compared`."""
        return tuple(f"log {name}" if name in self.variances else name for name in self.names)

    def compared(self, theta: Float[np.ndarray, "... parameter"]) -> Float[np.ndarray, "... parameter"]:
        """Return the quantities whose means and standard deviations samplers and certificates compare.

        These are the parameters, with error variances replaced by their logarithms. The posterior of a poorly determined
        variance has a tail like σ⁻⁴: however many draws there are, a few of them determine its standard deviation.

        Parameters
        ----------
        theta : ndarray, shape (..., parameter)
            In SI.

        Returns
        -------
        ndarray, shape (..., parameter)
            `theta` itself, or a changed copy.
        """
        places = [index for index, name in enumerate(self.names) if name in self.variances]
        if not places:
            return theta
        values = theta.copy()
        values[..., places] = _logarithm(values[..., places])
        return values

    def compared_of(
        self, index: int, theta: Float[np.ndarray, "step ensemble walker parameter"]
    ) -> Float[np.ndarray, "step ensemble walker"]:
        """Return one of the quantities of `compared`; a copy of all of them may be large."""
        values = theta[..., index]
        return _logarithm(values) if self.names[index] in self.variances else values

    @property
    def costs_runs(self) -> bool:
        """Whether each evaluation is a run of an expensive solver."""
        return False

    @abstractmethod
    def evaluate(self, phi: Float[np.ndarray, "run parameter"]) -> tuple[np.ndarray, np.ndarray]:
        """Log density in unconstrained coordinates.

        Parameters
        ----------
        phi : ndarray, shape (run, parameter)
            Unconstrained coordinates.

        Returns
        -------
        tuple of ndarray, shape (run,)
            Log density with respect to φ (−inf where it cannot be computed), and a mask of the failed simulations.
        """

    def evaluate_parts(self, phi: Float[np.ndarray, "run parameter"]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Log prior and log-likelihood separately, for samplers that move from the prior to the posterior.

        Parameters
        ----------
        phi : ndarray, shape (run, parameter)
            Unconstrained coordinates.

        Returns
        -------
        tuple of ndarray, shape (run,)
            Log prior with respect to φ; log-likelihood, −inf where it cannot be computed; and a mask of the failed simulations.

        Raises
        ------
        InputError
            If the target has no separate prior.
        """
        raise InputError(
            "SMC",
            f"a {type(self).__name__} without a separate prior",
            "a Posterior, or LogDensity(initial=ParameterSpace(…))",
        )

    @property
    def knows_prior(self) -> bool:
        """Whether prior and likelihood can be evaluated separately."""
        return False

    def traceable(self) -> tuple[Callable[[Any, Any], Any], Any]:
        """Return the density as a JAX function, for samplers that differentiate it.

        Returns
        -------
        tuple of callable and tree of arrays
            ``function(phi[run, parameter], data)``, which returns the log density in unconstrained coordinates, and the data.

        Raises
        ------
        InputError
            If the density is not a JAX function.
        """
        raise InputError(
            "NUTS",
            f"a {type(self).__name__} without derivatives",
            "a posterior on a built-in model or a surrogate, or LogDensity(backend='jax')",
            "Use SMC or AIES, which need no derivatives.",
        )

    @abstractmethod
    def log_density(self, theta: Float[np.ndarray, "run parameter"]) -> Float[np.ndarray, " run"]:
        """Log density with respect to the parameters.

        Parameters
        ----------
        theta : ndarray, shape (run, parameter)
            Parameters in SI.

        Returns
        -------
        ndarray, shape (run,)
            −inf outside the support and where a simulation failed.
        """

    @abstractmethod
    def initial(self, count: int, rng: np.random.Generator) -> Float[np.ndarray, "count parameter"]:
        """Draw points to start from, in unconstrained coordinates.

        Parameters
        ----------
        count : int
            Number of points.
        rng : numpy.random.Generator
            Source of randomness.

        Returns
        -------
        ndarray, shape (count, parameter)
            Over-dispersed starting points.
        """

    @property
    @abstractmethod
    def content_hash(self) -> str:
        """Hash of everything the density depends on."""


def _checked_bounds(where: str, pair: Any) -> np.ndarray:
    """Check that a lower bound is below an upper bound; either may be infinite."""
    bounds = real_array(where, pair, "a lower and an upper bound")
    if bounds.shape != (2,) or not bounds[0] < bounds[1]:
        raise InputError(where, f"{pair!r}", "a lower bound and a larger upper bound, such as (0.0, np.inf)")
    return bounds


def _never_infinite(value: np.ndarray, theta: np.ndarray) -> np.ndarray:
    """Refuse a log density of +∞, which would put all probability at one point."""
    if np.isposinf(value).any():
        index = int(np.argmax(np.isposinf(value)))
        at = ", ".join(f"{x:g}" for x in theta[index])
        raise InputError(
            "LogDensity.function", f"+inf at the point ({at})", "finite numbers, or -inf where the density is zero"
        )
    return value


@check_arguments
class LogDensity(Target):
    """Any log density as a target.

    Parameters
    ----------
    function : callable
        ``numpy``: maps ``theta[run, parameter]`` to ``log_density[run]``. ``jax``: a pure function of one point
        ``theta[parameter]``, which is batched and compiled here.
    names : sequence of str
        Names of the parameters.
    initial : ParameterSpace, ndarray (point, parameter), or callable
        Where chains may start: a prior to draw from, points to choose from, or ``initial(count, rng)``.
    bounds : mapping of str to pair of float, optional
        Support of the bounded parameters: ``{"tau": (0.0, np.inf)}``.
    backend : {"numpy", "jax"}
        Array library of `function`. JAX arrays in the function must be float64: begin with
        ``jax.config.update("jax_enable_x64", True)``.

    Examples
    --------
    >>> import numpy as np
    >>> import structid as si
    >>> start = si.ParameterSpace(a=si.Normal(0.0, 3.0), b=si.Normal(0.0, 3.0))
    >>> target = si.LogDensity(lambda x: -0.5 * (x**2).sum(axis=-1), names=("a", "b"), initial=start)
    >>> target.log_density(np.ones((1, 2)))
    array([-1.])
    """

    def __init__(
        self,
        function: Callable[[Any], Any],
        names: Sequence[str],
        initial: ParameterSpace | np.ndarray | Callable[[int, np.random.Generator], np.ndarray],
        bounds: dict[str, tuple[float, float]] | None = None,
        backend: str = "numpy",
    ) -> None:
        self.names = tuple(names)
        self.backend = check_choice("LogDensity.backend", backend, ("numpy", "jax"))
        box = np.tile([-np.inf, np.inf], (len(self.names), 1))
        for name, pair in (bounds or {}).items():
            index = self.names.index(check_choice("LogDensity.bounds", name, self.names))
            box[index] = _checked_bounds(f"LogDensity.bounds['{name}']", pair)
        self.bijection = Bijection(box)
        self._function, self._initial = function, initial

    @cached_property
    def _compiled(self) -> tuple[Callable[..., Any], Callable[..., Any]]:

        in_coordinates, data = self.traceable()
        return over_runs(jax.vmap(self._function)), over_runs(lambda phi: in_coordinates(phi, data))

    @property
    def knows_prior(self) -> bool:
        """Whether `initial` is a parameter space, which is then the prior."""
        return isinstance(self._initial, ParameterSpace)

    def traceable(self) -> tuple[Callable[[Any, Any], Any], Any]:
        """Return the density as a JAX function; see `Target.traceable`."""
        if self.backend != "jax":
            return super().traceable()

        batched = jax.vmap(self._function)

        def in_coordinates(phi: Any, data: Any) -> Any:
            theta, jacobian = self.bijection.forward(phi)
            return batched(theta) + jacobian

        return in_coordinates, ()

    def log_density(self, theta: np.ndarray) -> np.ndarray:
        """Log density with respect to the parameters; see `Target.log_density`."""
        theta = self._points(theta)
        value = self._values(theta) if self.backend == "numpy" else np.asarray(self._compiled[0](theta))
        return np.where(np.isnan(value), -np.inf, _never_infinite(value, theta))

    def _points(self, theta: np.ndarray) -> np.ndarray:
        """Points as rows; a single point may lack the run axis."""
        points = np.atleast_2d(np.asarray(theta, dtype=np.float64))
        if points.shape[1] != len(self.names):
            raise InputError(
                "LogDensity.log_density(theta)",
                f"an array of shape {np.shape(theta)}",
                f"(run, {len(self.names)}) with the columns {', '.join(self.names)}",
            )
        return points

    def _values(self, theta: np.ndarray) -> np.ndarray:
        """Values of the function, (run,)."""
        value = real_array("LogDensity.function", self._function(theta), "log densities")
        if len(theta) == 1 and value.ndim == 0:  # SciPy's multivariate distributions omit the axis of a single point
            value = value[None]
        value = value[:, 0] if value.shape == (len(theta), 1) else value
        if value.shape != (len(theta),):
            came = f"an array of shape {value.shape} for {len(theta)} points"
            raise InputError("LogDensity.function", came, f"shape ({len(theta)},)")
        return _never_infinite(value, theta)

    def evaluate(self, phi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Log density in unconstrained coordinates; see `Target.evaluate`."""
        if self.backend == "numpy":
            theta, jacobian = self.bijection(phi)
            value = self._values(theta) + jacobian
        else:
            value = _never_infinite(np.asarray(self._compiled[1](phi)), phi)
        failed = np.isnan(value)
        return np.where(failed, -np.inf, value), failed

    def evaluate_parts(self, phi: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Log prior and log-likelihood if `initial` is a parameter space (the prior); see `Target.evaluate_parts`."""
        if not isinstance(self._initial, ParameterSpace):
            return super().evaluate_parts(phi)  # raises InputError
        density, failed = self.evaluate(phi)
        theta, jacobian = self.bijection(phi)
        space = self._initial
        columns = np.array([self.names.index(n) for n in space.names])
        prior = space.log_density(theta[:, columns]) + jacobian
        outside = ~np.isfinite(prior)
        return prior, np.where(outside, -np.inf, density - np.where(outside, 0.0, prior)), failed

    def initial(self, count: int, rng: np.random.Generator) -> np.ndarray:
        """Draw starting points; see `Target.initial`."""
        if isinstance(self._initial, ParameterSpace):
            theta = self._initial.columns(
                self._initial.from_uniform(rng.random((count, self._initial.dimension))), self.names
            )
        elif callable(self._initial):
            theta = self._initial(count, rng)
        else:
            theta = rng.permutation(np.asarray(self._initial, dtype=np.float64))[:count]
        theta = np.asarray(theta, dtype=np.float64)
        if theta.shape != (count, self.dimension):
            raise InputError("LogDensity.initial", f"an array of shape {theta.shape}", f"({count}, {self.dimension})")
        return self.bijection.inverse(theta)

    @property
    def content_hash(self) -> str:
        """Hash of the names, the bounds and the function's behaviour."""
        return digest(self.names, self.bijection.bounds, function_identity(self._function))


def _logarithm(variances: np.ndarray) -> np.ndarray:
    return np.asarray(np.log(np.maximum(variances, np.finfo(np.float64).tiny)))
