"""Parameter spaces: named parameters with prior distributions, correlation and derived parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any, cast

import numpy as np
import scipy

from structid.core.errors import InputError, suggestion
from structid.core.hashing import digest, function_identity
from structid.core.notebook import ShownAsText
from structid.core.renamed import warn_of
from structid.core.units import factor
from structid.core.validation import COORDINATES, check_arguments, check_name
from structid.probability import copula
from structid.probability.bijections import Bijection
from structid.probability.derived import Derivation, derivations
from structid.probability.designs import Design, unit_design
from structid.probability.truncation import Marginal


@check_arguments
class ParameterSpace(ShownAsText):
    """The unknown parameters: names, prior distributions, correlation, and parameters derived from others.

    Parameters
    ----------
    priors : mapping of str to Marginal, optional
        One distribution for each parameter. A name that is invalid in Python or equals an argument below needs this
        form: ``ParameterSpace({"derived": Normal(…)})``.
    correlation : mapping of pair of str to float, or ndarray (parameter, parameter), optional
        Correlation of the Gaussian copula: ``{("stiffness", "alpha"): 0.4}`` or the whole matrix.
    derived : mapping of str to callable or str, optional
        Parameters derived from others: ``{"gamma": "gamma_ratio * beta"}``, or a function of a mapping from names to
        arrays that works on both NumPy and JAX arrays.
    coordinates : mapping of str to callable or str, optional
        Functions of the parameters, in the same notation, in which surrogates are fitted, since the response depends on them
        more simply: ``{"log_stiffness": "log(strength**2 / energy)"}``. They change nothing else.
    **marginals : Marginal
        Further parameters by name.

    Examples
    --------
    >>> import structid as si
    >>> space = si.ParameterSpace(stiffness=si.Normal(7.42, 0.742, unit="kN/mm"), beta=si.Uniform(55.0, 65.0, unit="1/m"))
    >>> space.sample(3, seed=1).values.shape
    (3, 2)
    """

    def __init__(
        self,
        priors: Mapping[str, Marginal] | None = None,
        /,
        *,
        correlation: Mapping[tuple[str, str], float] | np.ndarray | None = None,
        derived: Mapping[str, Derivation | str] | None = None,
        coordinates: Mapping[str, Derivation | str] | None = None,
        **marginals: Marginal,
    ) -> None:
        if _is_correlation(priors) and correlation is None:
            warn_of("ParameterSpace({('a', 'b'): 0.3}, …)", "ParameterSpace(correlation={('a', 'b'): 0.3}, …)")
            priors, correlation = None, cast(Any, priors)
        marginals = _by_name(priors, marginals)
        for name, argument in (("correlation", correlation), ("derived", derived), ("coordinates", coordinates)):
            if isinstance(argument, Marginal):
                raise InputError(
                    f"ParameterSpace({name})",
                    "a prior, but this name is an argument of ParameterSpace",
                    "a value of this argument",
                    f"Give a parameter of this name in a dictionary: ParameterSpace({{'{name}': …}}).",
                )
        for name in (*marginals, *(derived or {}), *(coordinates or {})):
            check_name("ParameterSpace", name, COORDINATES)
        for name, marginal in marginals.items():
            if not isinstance(marginal, Marginal):
                scipys = getattr(getattr(marginal, "dist", None), "name", "")
                raise InputError(
                    f"ParameterSpace({name})",
                    f"SciPy's {scipys}" if scipys else f"{marginal!r}",
                    "a distribution such as structid.Uniform(0.0, 1.0)",
                    "" if scipys else "Give a known value to the model, not to the space.",
                )
        self.marginals: dict[str, Marginal] = dict(marginals)
        self._correlation = copula.correlation_matrix(correlation, self.names)
        self._derived_source = dict(derived or {})
        self._derived = derivations(self._derived_source, self.names)
        self._coordinate_source = dict(coordinates or {})
        self._coordinates = derivations(self._coordinate_source, self.all_names, "coordinate")

    # --- names and units ----------------------------------------------------------------------------------------

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the sampled parameters, in the order of the columns."""
        return tuple(self.marginals)

    @property
    def all_names(self) -> tuple[str, ...]:
        """Names of the sampled and of the derived parameters."""
        return (*self.marginals, *self._derived)

    @property
    def dimension(self) -> int:
        """Number of sampled parameters."""
        return len(self.marginals)

    @property
    def units(self) -> dict[str, str]:
        """Declared unit of every sampled parameter."""
        return {name: m.unit for name, m in self.marginals.items()}

    @cached_property
    def factors(self) -> np.ndarray:
        """Factor that converts each parameter from its declared unit to SI, shape (parameter,)."""
        return np.array([factor(m.unit) for m in self.marginals.values()])

    @cached_property
    def bounds(self) -> np.ndarray:
        """Smallest and largest values in SI, shape (parameter, 2)."""
        return np.array([m.support for m in self.marginals.values()]).reshape(-1, 2)

    @property
    def correlation(self) -> np.ndarray | None:
        """Correlation matrix of the Gaussian copula, or None for independent parameters."""
        return self._correlation

    @property
    def content_hash(self) -> str:
        """Hash of names, distributions, derived parameters and correlation."""
        derived, coordinates = (
            {n: s if isinstance(s, str) else function_identity(s) for n, s in source.items()}
            for source in (self._derived_source, self._coordinate_source)
        )
        correlation = [] if self._correlation is None else self._correlation.tolist()
        more = [coordinates] if coordinates else []
        return digest({n: m.describe() for n, m in self.marginals.items()}, derived, correlation, *more)

    def to_plain(self) -> dict[str, Any]:
        """Describe the space for `from_plain`, ready for JSON; derived functions are included by name only.

        Returns
        -------
        dict
            Marginals, correlation, derived parameters.
        """
        return {
            "marginals": {n: m.to_plain() for n, m in self.marginals.items()},
            "correlation": None if self._correlation is None else self._correlation.tolist(),
            "derived": {n: s if isinstance(s, str) else None for n, s in self._derived_source.items()},
            "coordinates": {n: s if isinstance(s, str) else None for n, s in self._coordinate_source.items()},
        }

    @classmethod
    def from_plain(cls, plain: dict[str, Any]) -> ParameterSpace:
        """Rebuild a space from the description by `to_plain`.

        Parameters
        ----------
        plain : dict
            The description.

        Returns
        -------
        ParameterSpace
            The same space, but without derived parameters that are functions.
        """
        derived, coordinates = (
            {n: s for n, s in plain.get(key, {}).items() if s is not None} for key in ("derived", "coordinates")
        )
        correlation = None if plain["correlation"] is None else np.array(plain["correlation"])
        marginals = {n: Marginal.from_plain(m) for n, m in plain["marginals"].items()}
        return cls(marginals, correlation=correlation, derived=derived, coordinates=coordinates)

    def extended(self, **marginals: Marginal) -> ParameterSpace:
        """Return this space with additional, independent parameters.

        Parameters
        ----------
        **marginals : Marginal
            Distributions of the additional parameters.

        Returns
        -------
        ParameterSpace
            The larger space.
        """
        repeated = sorted(set(marginals) & set(self.all_names))
        if repeated:
            raise InputError("ParameterSpace", f"the name '{repeated[0]}' twice", "unique names", "Rename one of them.")
        correlation = None
        if self._correlation is not None:
            correlation = np.eye(self.dimension + len(marginals))
            correlation[: self.dimension, : self.dimension] = self._correlation
        return ParameterSpace(
            {**self.marginals, **marginals},
            correlation=correlation,
            derived=self._derived_source,
            coordinates=self._coordinate_source,
        )

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of the coordinates in which surrogates are fitted; empty if these are the parameters themselves."""
        return tuple(self._coordinates)

    # --- values -------------------------------------------------------------------------------------------------

    def complete(self, theta: Any) -> dict[str, Any]:
        """Values of all parameters by name, including derived parameters.

        Parameters
        ----------
        theta : array, shape (..., parameter)
            Points in SI, NumPy or JAX.

        Returns
        -------
        dict of str to array, shape (...)
            Values in SI.
        """
        values: dict[str, Any] = {name: theta[..., i] for i, name in enumerate(self.marginals)}
        for name, derive in self._derived.items():
            values[name] = derive(values)
        return values

    def columns(self, theta: Any, names: Sequence[str]) -> Any:
        """Values of named parameters.

        Parameters
        ----------
        theta : array, shape (..., parameter)
            Points in SI, NumPy or JAX.
        names : sequence of str
            Names of the parameters, in the order of the columns.

        Returns
        -------
        array, shape (..., name)
            Values in SI; the same kind of array as `theta`, but a JAX array if a parameter is derived.
        """
        missing = [n for n in names if n not in self.all_names]
        if missing:
            cure = suggestion(missing[0], self.all_names) or "Give it a prior, or fix it in the model."
            raise InputError("parameters", f"unknown name '{missing[0]}'", ", ".join(self.all_names), cure)
        if tuple(names) == self.names:
            return theta
        if isinstance(theta, np.ndarray) and not self._derived:
            return theta[..., [self.names.index(n) for n in names]]
        from structid.engine.device import jnp

        values = self.complete(theta)
        shape = theta.shape[:-1]
        return jnp.stack([jnp.broadcast_to(values[n], shape) for n in names], axis=-1) if names else theta[..., :0]

    def in_coordinates(self, theta: Any) -> Any:
        """Values of the coordinates.

        Parameters
        ----------
        theta : array, shape (..., parameter)
            Points in SI, NumPy or JAX.

        Returns
        -------
        array, shape (..., coordinate)
            Array of the same kind as `theta`.
        """
        values = self.complete(theta)
        columns = [of(values) for of in self._coordinates.values()]
        if isinstance(theta, np.ndarray):
            return np.stack([np.broadcast_to(np.asarray(c), theta.shape[:-1]) for c in columns], axis=-1)
        from structid.engine.device import jnp

        return jnp.stack([jnp.broadcast_to(c, theta.shape[:-1]) for c in columns], axis=-1)

    def sample(self, count: int, seed: int, method: str = "latin_hypercube", widen: float = 1.0) -> Design:
        """Draw a design from the prior, or from a wider distribution.

        Parameters
        ----------
        count : int
            Number of points.
        seed : int
            Seed; the same seed gives the same design.
        method : {"latin_hypercube", "maximin", "sobol", "random"}
            How to place the points.
        widen : float
            Factor on the normal scores. Use 1.3 to 1.6 for the training of a surrogate, whose design should reach
            further into the tails than the points of later evaluations. Bounds still hold.

        Returns
        -------
        Design
            Points in SI.
        """
        if not (np.isfinite(widen) and widen > 0):
            raise InputError("sample: widen", f"{widen}", "a positive number; 1 draws from the prior itself")
        if self.dimension == 0:
            return Design(np.zeros((count, 0)), self)
        points = unit_design(count, self.dimension, seed, method)
        if widen != 1.0:
            points = np.clip(scipy.special.ndtr(widen * scipy.special.ndtri(points)), 1e-12, 1.0 - 1e-12)
        return Design(self.from_uniform(points), self)

    def from_uniform(self, u: np.ndarray) -> np.ndarray:
        """Map the unit cube to the prior (inverse Rosenblatt transform of the copula).

        Parameters
        ----------
        u : ndarray, shape (..., parameter)
            Points of the unit cube.

        Returns
        -------
        ndarray, shape (..., parameter)
            Points in SI.
        """
        if self._correlation is not None:
            u = copula.correlated(u, self._correlation)
        return np.stack([m.quantile(u[..., i]) for i, m in enumerate(self.marginals.values())], axis=-1)

    def to_uniform(self, theta: np.ndarray) -> np.ndarray:
        """Map the prior to the unit cube; the inverse of `from_uniform`.

        Parameters
        ----------
        theta : ndarray, shape (..., parameter)
            Points in SI.

        Returns
        -------
        ndarray, shape (..., parameter)
            Points of the unit cube, uniform and independent under the prior.
        """
        u = self.cdf(theta)
        return u if self._correlation is None else copula.decorrelated(u, self._correlation)

    def cdf(self, theta: np.ndarray) -> np.ndarray:
        """Marginal cumulative distributions.

        Parameters
        ----------
        theta : ndarray, shape (..., parameter)
            Points in SI.

        Returns
        -------
        ndarray, shape (..., parameter)
            Probabilities.
        """
        theta = np.asarray(theta, dtype=np.float64)
        return np.stack([m.cdf(theta[..., i]) for i, m in enumerate(self.marginals.values())], axis=-1)

    def quantile(self, p: np.ndarray) -> np.ndarray:
        """Marginal quantiles.

        Parameters
        ----------
        p : ndarray, shape (..., parameter)
            Probabilities.

        Returns
        -------
        ndarray, shape (..., parameter)
            Values in SI.
        """
        return np.stack([m.quantile(np.asarray(p)[..., i]) for i, m in enumerate(self.marginals.values())], axis=-1)

    def log_density(self, theta: np.ndarray) -> np.ndarray:
        """Logarithm of the joint prior density.

        Parameters
        ----------
        theta : ndarray, shape (..., parameter)
            Points in SI.

        Returns
        -------
        ndarray, shape (...)
            Log density; −inf outside the support.
        """
        theta = np.asarray(theta, dtype=np.float64)
        parts = [m.log_density(theta[..., i]) for i, m in enumerate(self.marginals.values())]
        total: np.ndarray = np.sum(parts, axis=0)
        if self._correlation is None:
            return total
        z = scipy.special.ndtri(np.clip(self.cdf(theta), 1e-300, 1 - 1e-16))
        joint: np.ndarray = total + copula.copula_log_density(z, self._correlation, np)
        return joint

    # --- inside JAX ---------------------------------------------------------------------------------------------

    def jax_log_density(self, theta: Any) -> Any:
        """Joint prior log density inside JAX, with gradients.

        Parameters
        ----------
        theta : jax.Array, shape (..., parameter)
            Points in SI.

        Returns
        -------
        jax.Array, shape (...)
            Log density; −inf outside the support.
        """
        import jax.scipy.special as special

        from structid.engine.device import jnp

        parts = [m.jax_log_density(theta[..., i]) for i, m in enumerate(self.marginals.values())]
        total = sum(parts, start=jnp.zeros(theta.shape[:-1]))
        if self._correlation is None:
            return total
        u = jnp.stack([m.jax_cdf(theta[..., i]) for i, m in enumerate(self.marginals.values())], axis=-1)
        z = special.ndtri(jnp.clip(u, 1e-300, 1 - 1e-16))
        return total + copula.copula_log_density(z, self._correlation, jnp)

    @cached_property
    def bijection(self) -> Bijection:
        """Smooth map between ℝᵈ and the support; the prior interquartile range/1.349 scales unbounded parameters.

        In a space with coordinates, bounded positive parameters are mapped by an exponential that ignores their bounds.
        Such coordinates are ratios and products, along which posteriors are narrow ridges.
        """
        quartiles = np.array([m.quantile(np.array([0.25, 0.75])) for m in self.marginals.values()]).reshape(-1, 2)
        positive = np.isfinite(self.bounds).all(axis=1) & (self.bounds[:, 0] > 0.0)
        logarithmic = np.flatnonzero(positive).tolist() if self.coordinates else ()
        return Bijection(self.bounds, (quartiles[:, 1] - quartiles[:, 0]) / 1.349, logarithmic=logarithmic)

    def __repr__(self) -> str:
        rows = [f"  {name}: {m}" for name, m in self.marginals.items()]
        texts = {n: s if isinstance(s, str) else "function" for n, s in self._derived_source.items()}
        rows += [f"  {name} = {text}" for name, text in texts.items()]
        return "ParameterSpace(\n" + "\n".join(rows) + "\n)"


def _is_correlation(priors: object) -> bool:
    """Whether the first argument is a correlation, as in an older signature."""
    if isinstance(priors, Mapping):
        return bool(priors) and all(isinstance(pair, tuple) for pair in priors)
    rows = priors if isinstance(priors, (list, tuple)) else ()
    return isinstance(priors, np.ndarray) or (
        bool(rows) and all(isinstance(row, (list, tuple, np.ndarray)) for row in rows)
    )


def _by_name(priors: object, marginals: dict[str, Marginal]) -> dict[str, Marginal]:
    """Combine the priors of a dictionary with those of keyword arguments."""
    if priors is None:
        return marginals
    if not isinstance(priors, Mapping) or not all(isinstance(name, str) for name in priors):
        raise InputError(
            "ParameterSpace",
            "a first argument that is not a dictionary of priors",
            "priors by name: ParameterSpace(stiffness=Normal(…), …) or ParameterSpace({'stiffness': Normal(…), …})",
            "Give a correlation as a keyword argument: correlation=….",
        )
    if repeated := sorted(set(priors) & set(marginals)):
        raise InputError("ParameterSpace", f"the name '{repeated[0]}' twice", "unique names", "Rename one of them.")
    return {**priors, **marginals}
