"""Log densities whose moments are known."""

import numpy as np

from structid.inference.target import LogDensity

RNG = np.random.default_rng(7)

A = RNG.standard_normal((5, 5))

COVARIANCE = A @ A.T / 5 + 0.2 * np.eye(5)

PRECISION = np.linalg.inv(COVARIANCE)

MEAN = np.arange(5) * 0.5


def gaussian():
    density = lambda x: -0.5 * np.einsum("ij,jk,ik->i", x - MEAN, PRECISION, x - MEAN)  # noqa: E731
    return LogDensity(density, "abcde", lambda n, rng: MEAN + 3 * rng.standard_normal((n, 5)))


def skewed():
    """Independent gammas of shape 2 and 5: mean 2, 5; sd √2, √5; on the positive half-line, through the bijection."""
    density = lambda x: (np.array([1.0, 4.0]) * np.log(x) - x).sum(axis=1)  # noqa: E731
    bounds = {"a": (0.0, np.inf), "b": (0.0, np.inf)}
    return LogDensity(density, "ab", lambda n, rng: rng.gamma(1.0, 3.0, (n, 2)) + 1e-3, bounds)


def banana():
    """x ~ N(0, 1), y | x ~ N(x², 0.5²): E y = 1, var y = 2 + 0.25."""
    density = lambda x: -0.5 * x[:, 0] ** 2 - 0.5 * ((x[:, 1] - x[:, 0] ** 2) / 0.5) ** 2  # noqa: E731
    return LogDensity(density, "xy", lambda n, rng: rng.standard_normal((n, 2)) * 2)


TARGETS = {
    "gaussian": (gaussian, MEAN, np.sqrt(np.diag(COVARIANCE))),
    "skewed": (skewed, np.array([2.0, 5.0]), np.sqrt([2.0, 5.0])),
    "banana": (banana, np.array([0.0, 1.0]), np.array([1.0, 1.5])),
}
