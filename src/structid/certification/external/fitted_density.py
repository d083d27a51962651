"""A density fitted to draws by maps of the marginals to normal distributions, which alternate with rotations.

S. S. Chen & R. A. Gopinath (2000), Gaussianization, Advances in Neural Information Processing Systems 13. In every layer each
coordinate is mapped by the sinh-arcsinh transformation of M. C. Jones & A. Pewsey (2009), doi 10.1093/biomet/asp053, whose four
parameters (location, scale, skewness, tail weight) are fitted by maximum likelihood. The first layer whitens the draws; every
further layer rotates them at random. A composition of such maps has a density that can be evaluated and sampled.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from jaxtyping import Float

MOST_LAYERS = 12
"""Largest number of layers. Layer 1 makes the marginals normal; each further layer captures nonlinear dependence."""
HELD_OUT = 0.2
"""Fraction of the draws held out to choose the number of layers, since every layer also fits noise."""
LARGEST_ANGLE = 300.0
"""Largest argument of sinh and cosh, far beyond any draw; squares of larger values overflow."""
LARGEST_LOG = 3.0
"""Largest change of a log width from its initial value, and largest absolute value of a skewness."""


@dataclass(frozen=True, eq=False)
class _Layer:
    """z = sinh(δ asinh((y − ξ)/λ) − ε), with y = R (x − centre) the whitened or rotated coordinates."""

    centre: Float[np.ndarray, " parameter"]  # subtracted first
    rotation: Float[np.ndarray, "parameter parameter"]  # R; of any determinant
    shape: Float[np.ndarray, "4 parameter"]  # ξ, log λ, ε, log δ

    def forward(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Coordinates after the layer, and the log determinant of its Jacobian."""
        z, slope = _sinh_arcsinh((x - self.centre) @ self.rotation.T, self.shape)
        return z, slope.sum(axis=1) + np.linalg.slogdet(self.rotation)[1]

    def backward(self, z: np.ndarray) -> np.ndarray:
        """Coordinates before the layer."""
        location, log_width, skew, log_tail = self.shape
        y = location + np.exp(log_width) * np.sinh((np.arcsinh(z) + skew) / np.exp(log_tail))
        return np.asarray(np.linalg.solve(self.rotation, y.T).T + self.centre)


def _sinh_arcsinh(y: np.ndarray, shape: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Compute z and log dz/dy."""
    location, log_width, skew, log_tail = shape
    standard = (y - location) / np.exp(log_width)
    angle = np.exp(log_tail) * np.arcsinh(standard) - skew
    # dz/dy = cosh(angle) δ / (λ √(1 + s²)); log cosh a = |a| + log(1 + e^(−2|a|)) − log 2
    log_cosh = np.abs(angle) + np.log1p(np.exp(-2.0 * np.abs(angle))) - np.log(2.0)
    return np.sinh(angle), log_cosh + log_tail - log_width - np.log(np.hypot(1.0, standard))


def _unlikely(shape: np.ndarray, y: np.ndarray) -> tuple[float, np.ndarray]:
    """Mean of ½ z² − log dz/dy over values, and its gradient with respect to ξ, log λ, ε and log δ.

    With s = (y − ξ)/λ and a = δ asinh s − ε, it is ½ sinh² a − log cosh a − log δ + log λ + ½ log(1 + s²).
    """
    location, log_width, skew, log_tail = shape
    standard = (y - location) / np.exp(log_width)
    square = 1.0 + standard**2
    stretched = np.exp(log_tail) * np.arcsinh(standard)
    angle = np.clip(stretched - skew, -LARGEST_ANGLE, LARGEST_ANGLE)
    sinh, cosh = np.sinh(angle), np.cosh(angle)
    value = np.mean(0.5 * sinh**2 - np.log(cosh) + 0.5 * np.log(square)) - log_tail + log_width
    by_angle = sinh * cosh - sinh / cosh
    by_standard = by_angle * np.exp(log_tail) / np.sqrt(square) + standard / square
    gradient = [
        -by_standard.mean() / np.exp(log_width),
        1.0 - np.mean(by_standard * standard),
        -by_angle.mean(),
        np.mean(by_angle * stretched) - 1.0,
    ]
    return float(value), np.array(gradient)


def _most_likely(y: np.ndarray) -> np.ndarray:
    """ξ, log λ, ε, log δ of one coordinate by maximum likelihood."""
    begin = np.array([y.mean(), np.log(y.std()), 0.0, 0.0])
    bounds = [(None, None), (begin[1] - LARGEST_LOG, begin[1] + LARGEST_LOG), (-LARGEST_LOG, LARGEST_LOG), (-1.0, 1.0)]
    optimum = scipy.optimize.minimize(_unlikely, begin, args=(y,), jac=True, method="L-BFGS-B", bounds=bounds)
    return np.asarray(optimum.x)


def _rotation(dimension: int, rng: np.random.Generator) -> np.ndarray:
    """A random rotation."""
    return np.asarray(scipy.stats.ortho_group.rvs(dimension, random_state=rng)) if dimension > 1 else np.eye(1)


def _layers(x: np.ndarray, rotations: list[np.ndarray]) -> tuple[_Layer, ...]:
    """A whitening layer, and one for each rotation, fitted one after another."""
    layers: list[_Layer] = []
    for rotation in (np.linalg.inv(np.linalg.cholesky(np.atleast_2d(np.cov(x.T)))), *rotations):
        centre = x.mean(axis=0)
        y = (x - centre) @ rotation.T
        layers.append(_Layer(centre, rotation, np.stack([_most_likely(column) for column in y.T], axis=1)))
        x = layers[-1].forward(x)[0]
    return tuple(layers)


@dataclass(frozen=True, eq=False)
class FittedDensity:
    """A density fitted to draws."""

    layers: tuple[_Layer, ...]  # maps from the draws to standard normal coordinates

    @classmethod
    def of(cls, draws: Float[np.ndarray, "draw parameter"], rng: np.random.Generator) -> FittedDensity:
        """Fit a density."""
        order = rng.permutation(len(draws))
        held_out, kept = np.split(order, [round(HELD_OUT * len(draws))])
        dimension = draws.shape[1]
        rotations = [_rotation(dimension, rng) for _ in range(MOST_LAYERS - 1)]
        trial = cls(_layers(draws[kept], rotations))
        likely = [cls(trial.layers[:count]).log_density(draws[held_out]).mean() for count in range(1, MOST_LAYERS + 1)]
        return cls(_layers(draws, rotations[: int(np.argmax(likely))]))

    def in_normal_coordinates(self, x: Float[np.ndarray, "point parameter"]) -> tuple[np.ndarray, np.ndarray]:
        """Map points to coordinates in which the density is standard normal; those of points far away may be infinite or NaN."""
        total = np.zeros(len(x))
        with np.errstate(over="ignore", invalid="ignore"):
            for layer in self.layers:
                x, slope = layer.forward(x)
                total += slope
        return x, total

    def of_normal_coordinates(self, z: Float[np.ndarray, "point parameter"]) -> Float[np.ndarray, "point parameter"]:
        """Map points back from normal coordinates."""
        for layer in reversed(self.layers):
            z = layer.backward(z)
        return z

    def log_density(self, x: Float[np.ndarray, "point parameter"], width: float = 1.0) -> Float[np.ndarray, " point"]:
        """Log density, normalised; −inf far from all draws."""
        z, slope = self.in_normal_coordinates(x)
        with np.errstate(over="ignore", invalid="ignore"):
            normal = -0.5 * np.sum((z / width) ** 2, axis=1) - z.shape[1] * (np.log(width) + 0.5 * np.log(2.0 * np.pi))
            density = slope + normal
        return np.where(np.isnan(density), -np.inf, density)

    def draw(self, count: int, rng: np.random.Generator, width: float = 1.0) -> Float[np.ndarray, "count parameter"]:
        """Draw from the fitted density, or from a wider density that extends beyond the draws.

        A curved ridge is straight in the normal coordinates, so that draws beyond its ends still follow it.
        """
        return self.of_normal_coordinates(width * rng.standard_normal((count, len(self.layers[0].centre))))
