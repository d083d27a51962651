"""Parameters of a specimen's constitutive law, estimated during a test by an unscented Kalman filter.

Source: S. J. Julier & J. K. Uhlmann (2004, Proc. IEEE 92, 401). The state is the memory of a spring, z and e_h, and the
parameters in standard-normal coordinates φ of their priors, θ = F⁻¹(Φ(φ)). The filter therefore starts exactly from the prior,
and no parameter leaves its range.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.special import ndtr

from structid.core.errors import InputError
from structid.core.validation import check_arguments
from structid.hybrid.online.updated_springs import UpdatedSprings
from structid.mechanics.restoring_forces import HystereticSprings
from structid.models.traceable import TraceableModel, as_traceable
from structid.probability.space import ParameterSpace

CENTRE = 2.0
"""Weight of the central sigma point in covariances, exact for normal states. Its weight in means is zero."""
BAND = 1.959964
"""Half-width of a 95 % band [standard deviations]."""
REMEMBERED = ("z", "e_h")
"""Memory variables of a spring besides its displacement."""
LEAST_VARIANCE = 1e-18
"""Variance assigned to an exactly known state; positive, so that the covariance has a Cholesky factor."""


@dataclass(frozen=True, eq=False)
class FilteredPath:
    """Parameter estimates of the filter after every move."""

    names: tuple[str, ...]  # names of the parameters
    mean: Float[np.ndarray, "move parameter"]  # mean, in SI
    low: Float[np.ndarray, "move parameter"]  # lower end of the 95 % band, in SI
    high: Float[np.ndarray, "move parameter"]  # upper end of the 95 % band, in SI


@check_arguments
class UnscentedFilter:
    """Filter that estimates the parameters of a one-channel specimen after every move, and can update the numerical part.

    Its estimate is helpful during a test, but it is not a posterior. It assumes a correct constitutive law, a normal state and
    independent noise. If an assumption is wrong, its bands are too narrow, without a warning.

    Parameters
    ----------
    model : TraceableModel
        Model of one spring with free parameters, such as `BoucWen`.
    space : ParameterSpace
        Priors of the free parameters.
    force_noise : float
        Standard deviation of a measured force [N].
    drift : float
        Standard deviation of a random walk of the normal scores per move; if positive, earlier moves lose weight.
    updates : UpdatedSprings, optional
        Springs of the numerical part with the same constitutive law as the specimen.

    Raises
    ------
    InputError
        If the model is not a single spring, or the noise is not positive.

    Examples
    --------
    >>> import structid as si
    >>> space = si.ParameterSpace(stiffness=si.Normal(7.0, 0.7, unit="kN/mm"))
    >>> model = si.BoucWen(mass=12e3, alpha=0.05, beta=63.0, gamma=63.0, free=space.names)
    >>> online = si.UnscentedFilter(model, space, force_noise=200.0)
    """

    def __init__(
        self,
        model: TraceableModel,
        space: ParameterSpace,
        force_noise: float,
        *,
        drift: float = 0.0,
        updates: UpdatedSprings | None = None,
    ) -> None:
        self.model, self.space, self.updates = as_traceable(model, "UnscentedFilter.model"), space, updates
        if not (force_noise > 0.0 and drift >= 0.0):
            came = f"a noise of {force_noise:g} N, a drift of {drift:g}"
            raise InputError("UnscentedFilter", came, "a positive noise, and a drift of 0 or more")
        self.force_noise, self.drift = force_noise, drift
        self._columns = [space.names.index(name) for name in self.model.free]
        if not isinstance(force := self._forces(self._theta(np.zeros((1, len(space.names))))), HystereticSprings):
            raise InputError(
                "UnscentedFilter.model", f"a {model.kind_in_words}", "a model of one spring, such as BoucWen"
            )
        if force.dofs != 1:
            raise InputError("UnscentedFilter.model", f"{force.dofs} displacements", "one displacement")
        count = len(REMEMBERED) + len(space.names)
        self._mean = np.zeros(count)
        self._covariance = np.eye(count)
        self._covariance[: len(REMEMBERED)] *= LEAST_VARIANCE
        self._place, self._datum = 0.0, 0.0
        self._path: list[np.ndarray] = []

    # --- during a test ------------------------------------------------------------------------------------------

    def begin(self, datum: float) -> None:
        """Start a test; the estimate from earlier tests is kept.

        Parameters
        ----------
        datum : float
            Zero of the test, relative to the first zero [m]; the specimen moved there without a measurement.
        """
        self._datum, self._path = datum, []
        if datum != self._place:
            self._moved(datum, None)

    def see(self, displacement: float, force: float) -> None:
        """Update the estimate with a move.

        Parameters
        ----------
        displacement : float
            Measured displacement, relative to the zero of the test [m].
        force : float
            Measured force [N].
        """
        self._moved(self._datum + displacement, force)
        scores, sd = self._mean[len(REMEMBERED) :], np.sqrt(np.diag(self._covariance)[len(REMEMBERED) :])
        self._path.append(self._theta(np.stack([scores, scores - BAND * sd, scores + BAND * sd])))
        if self.updates is not None:
            springs = self._forces(self._path[-1][:1])
            self.updates.adopt(springs)

    def path(self) -> FilteredPath:
        """Return the estimates of the filter in this test.

        Returns
        -------
        FilteredPath
            Estimate after every move.
        """
        band = np.reshape(self._path, (len(self._path), 3, len(self.space.names)))
        return FilteredPath(tuple(self.space.names), band[:, 0], band[:, 1], band[:, 2])

    # --- the filter ---------------------------------------------------------------------------------------------

    def _theta(self, scores: np.ndarray) -> np.ndarray:
        """θ = F⁻¹(Φ(φ)), shape (point, parameter)."""
        return self.space.quantile(np.clip(ndtr(scores), 1e-12, 1.0 - 1e-12))

    def _forces(self, theta: np.ndarray) -> Any:
        return self.model.static_force(theta[:, self._columns])

    def _moved(self, place: float, measured: float | None) -> None:
        """Propagate all sigma points to a displacement, and correct the state with the force measured there."""
        count, memory = len(self._mean), len(REMEMBERED)
        root = np.linalg.cholesky(self._covariance + LEAST_VARIANCE * np.eye(count))
        spread = np.sqrt(count) * root.T
        points = np.concatenate([self._mean[None], self._mean + spread, self._mean - spread])
        remembered = {name: points[None, :, k] for k, name in enumerate(REMEMBERED)}
        remembered["d"] = np.full((1, len(points)), self._place)
        forces, after = self._forces(self._theta(points[:, memory:])).at(remembered, np.full((1, len(points)), place))
        points[:, :memory] = np.stack([after[name][0] for name in REMEMBERED], axis=1)
        self._place = place
        weights = np.r_[0.0, np.full(2 * count, 0.5 / count)]
        of_products = np.r_[CENTRE, weights[1:]]
        self._mean = weights @ points
        away = points - self._mean
        self._covariance = away.T @ (of_products[:, None] * away)
        self._covariance[memory:, memory:] += self.drift**2 * np.eye(count - memory)
        if measured is None:
            return
        predicted = float(weights @ forces[0])
        missed = forces[0] - predicted
        variance = float(of_products @ missed**2) + self.force_noise**2
        gain = away.T @ (of_products * missed) / variance
        self._mean = self._mean + gain * (measured - predicted)
        corrected = self._covariance - variance * np.outer(gain, gain)
        self._covariance = 0.5 * (corrected + corrected.T)
