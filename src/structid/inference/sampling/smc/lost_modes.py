"""Search for modes that particles have lost, from draws of the prior.

While the exponent is small, a narrow mode contains few particles or none, whatever its final mass. Of two Gaussian
modes of widths s₁ < s₂ in d dimensions, the narrow mode begins with a fraction of about (s₁/s₂)^d. Once all populations
have lost their last particle there, they agree, although the mode is missing. An uphill search needs no particles in
the mode; it finds the mode if it begins in the mode's basin of attraction.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Bool, Float

from structid.inference.target import Target

COVERED = 0.999
"""Probability of the ellipsoid of a mode that counts as covered by it."""
THIN = 3.0
"""Mass of a mode over its share of the particles from which the particles restart."""
VALLEY = 1.0
"""Fall of the log density along the path between two points that counts as a valley."""
PLACES = (0.0, 0.02, 0.1, 0.25, 0.4, 0.55, 0.7, 0.85, 1.0)
"""Fractions of a path at which the density is evaluated; those near the start show in which basin the start lies."""
NEIGHBOURS = 10
"""Number of nearest particles from which valleys must separate a new mode, and largest number of centres."""
SEARCHES = 8
"""Searches per round."""
ROUNDS = 4
"""Largest number of rounds; in a curved posterior, straight paths cross valleys even without a further mode."""
TREND = 20
"""Points per coefficient for fitting a trend of the log density."""
FARTHEST_BELOW = 1e6
"""Distance below the largest log density [nat] beyond which a point says nothing of a trend near the modes."""
IN_A_PART = 10_000
"""Number of points at which the trend is evaluated at once."""
LENGTHS = (0.25, 0.5, 1.0, 2.0)
"""Step lengths uphill, relative to the distance to a fitted parabola's maximum."""
STEP = 1e-5
"""Step of finite differences, in unconstrained coordinates."""
STEEPEST = 1e100
"""Largest derivative of a log density; noise-free data have no largest density, and derivatives of 1e199 near it."""
WIDEST = 10.0
"""Largest standard deviation that a mode's curvature may imply, in unconstrained coordinates."""


class Mode(NamedTuple):
    """A local maximum of a density with its Laplace approximation."""

    middle: Float[np.ndarray, " parameter"]  # position in unconstrained coordinates
    log_density: float  # log density there
    # Cholesky factor of the covariance, the inverse of the density's curvature
    factor: Float[np.ndarray, "parameter parameter"]

    @property
    def log_mass(self) -> float:
        """Log ∫ π over the mode: log π + (d/2) log 2π + ½ log det Σ."""
        spread = np.log(np.diag(self.factor)).sum()
        return float(self.log_density + 0.5 * len(self.middle) * np.log(2.0 * np.pi) + spread)

    def covers(self, points: Float[np.ndarray, "point parameter"]) -> Bool[np.ndarray, " point"]:
        """Whether points lie where nearly all of a normal mode lies."""
        z = scipy.linalg.solve_triangular(self.factor, (points - self.middle).T, lower=True)
        return np.asarray(np.sum(z**2, axis=0) <= scipy.stats.chi2.ppf(COVERED, len(self.middle)))


def lost_modes(
    target: Target,
    particles: Float[np.ndarray, "particle parameter"],
    log_density: Float[np.ndarray, " particle"],
    scouts: Float[np.ndarray, "scout parameter"],
) -> list[Mode]:
    """Search for modes without particles.

    Each starting point (scout) moves one step uphill in log density. It is skipped if the density never falls on the
    straight path from there to a known mode. Otherwise a search climbs from the point where the density begins to fall.
    Searches begin with the scouts of highest density. The maximum is a new mode if valleys separate it from the
    surrounding particles.
    """
    return _lost(_Known(target, particles, log_density), scouts)


def _lost(explored: _Known, scouts: np.ndarray) -> list[Mode]:
    """Modes without particles; see `lost_modes`."""
    density = explored.density(scouts)
    scouts, density = explored.one_step_uphill(scouts[np.isfinite(density)], density[np.isfinite(density)])
    for centre in explored.centres:
        falls, scouts, density = explored.before_falls(scouts, density, centre[0])
        scouts, density = scouts[falls], density[falls]
    modes: list[Mode] = []
    for _ in range(ROUNDS):
        densest = np.argsort(-density, kind="stable")[:SEARCHES]
        rest = np.setdiff1d(np.arange(len(scouts)), densest)
        led_back: list[np.ndarray] = []
        for scout in densest:
            if not all(explored.divided(scouts[scout], density[scout], mode) for mode in modes):
                continue
            if not all(explored.before_falls(scouts[[scout]], density[[scout]], other)[0][0] for other in led_back):
                continue
            mode = _climbed(explored, scouts[scout])
            if explored.is_new(mode) and all(explored.divided(mode.middle, mode.log_density, other) for other in modes):
                modes.append(mode)
            else:
                led_back.append(scouts[scout])
        scouts, density = scouts[rest], density[rest]
        # If the density never falls on the path to one of these points, both ascents end at the same maximum.
        for scout in (*(mode.middle for mode in modes), *led_back):
            falls, *_ = explored.before_falls(scouts, density, scout)
            scouts, density = scouts[falls], density[falls]
        if not len(scouts):
            break
    return modes


def thin_modes(
    target: Target,
    particles: Float[np.ndarray, "particle parameter"],
    log_density: Float[np.ndarray, " particle"],
    starts: Float[np.ndarray, "start parameter"],
    log_evidence: float,
) -> list[Mode]:
    """Search for modes with far fewer particles than their mass asks for: a spike inside a wide mode, without a valley between.

    Searches climb from the densest particles and further points. The mass of a maximum comes from its curvature.
    """
    explored = _Known(target, particles, log_density)
    modes: list[Mode] = []
    thin: list[Mode] = []
    for start in (*(centre for centre, _ in explored.centres), *starts):
        if any(known.covers(start[None])[0] for known in modes):
            continue
        mode = _climbed(explored, start)
        share = max(float(np.mean(mode.covers(particles))), 1.0 / len(particles))
        again = any(known.covers(mode.middle[None])[0] for known in thin)
        if mode.log_mass - log_evidence > np.log(THIN * share) and not again:
            thin.append(mode)
        modes.append(mode)
    return thin


def densest(
    points: Float[np.ndarray, "point parameter"], log_density: Float[np.ndarray, " point"]
) -> Float[np.ndarray, "dense_point parameter"]:
    """The points of highest log density, and those where it exceeds most what a trend over all points predicts."""
    # Once each, and in their order: the trend is fitted to the first ones.
    once = np.sort(np.unique(points, axis=0, return_index=True)[1])
    points, log_density = points[once], log_density[once]
    near = log_density > np.max(log_density, initial=-np.inf) - FARTHEST_BELOW
    points, log_density = points[near], log_density[near]
    if len(points) <= 2 * SEARCHES:
        return points
    highest = np.argsort(-log_density, kind="stable")[:SEARCHES]
    above = np.argsort(-_above_trend(points, log_density), kind="stable")[:SEARCHES]
    return np.asarray(points[np.union1d(highest, above)])


def all_modes(
    target: Target,
    particles: np.ndarray,
    log_density: np.ndarray,
    scouts: np.ndarray,
    many: Float[np.ndarray, "point parameter"],
    most: int,
) -> list[Mode]:
    """Find the modes with particles, and the modes that have lost their particles."""
    explored = _Known(target, particles, log_density)
    modes: list[Mode] = []
    for centre, _ in explored.centres:
        mode = _climbed(explored, centre)
        if all(explored.divided(mode.middle, mode.log_density, other) for other in modes):
            modes.append(mode)
    scouts = scouts[np.isfinite(scouts).all(axis=1)]
    return modes + _lost(explored, np.concatenate([scouts, explored.promising(many, most)]))


class _Known:
    """The density, and the positions of particles."""

    def __init__(self, target: Target, particles: np.ndarray, log_density: np.ndarray) -> None:
        self.target = target
        self.particles, unique = np.unique(particles, axis=0, return_index=True)
        self.log_density = log_density[unique]
        self.centres = self._centres()

    def density(self, phi: np.ndarray) -> np.ndarray:
        """Log density at some points."""
        return self.target.evaluate(phi)[0] if len(phi) else np.zeros(0)

    def promising(self, many: np.ndarray, most: int) -> np.ndarray:
        """Choose starting points of searches: half of them arbitrary, half where the density is highest above a trend.

        In ten dimensions, a mode a third as wide as another mode has a basin of 1/10 000 of the prior. The density there may
        be low, but it exceeds what the trend towards the other mode predicts.
        """
        density = self.density(many)
        many, density = many[np.isfinite(density)], density[np.isfinite(density)]
        if len(many) <= most:
            return many
        above = np.argsort(-_above_trend(many, density), kind="stable")
        return np.asarray(many[np.union1d(np.arange(most // 2), above[: most // 2])])

    def one_step_uphill(self, start: np.ndarray, own_density: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Each point after its best step along the gradient, and the log density there."""
        count, dimension = start.shape
        probes = (start[:, None] + STEP * np.eye(dimension)).reshape(-1, dimension)
        slope = _finite((self.density(probes).reshape(count, dimension) - own_density[:, None]) / STEP)
        steepness = np.linalg.norm(slope, axis=1, keepdims=True)
        direction = slope / np.where(steepness > 0.0, steepness, 1.0)
        # A parabola through the point with its slope, and through a point close by: f(t) = f + s t − c t²/2.
        near = 1e3 * STEP
        curvature = _finite(
            2.0 * (steepness[:, 0] * near + own_density - self.density(start + near * direction)) / near**2
        )
        length = steepness[:, 0] / np.maximum(np.abs(curvature), 1e-12)
        length = np.minimum(length, np.linalg.norm(start.std(axis=0)))[:, None]
        steps = np.stack([start, *(start + share * length * direction for share in LENGTHS)])
        density = np.stack([own_density, *self.density(steps[1:].reshape(-1, dimension)).reshape(len(LENGTHS), count)])
        best = density.argmax(axis=0)
        return steps[best, np.arange(count)], density[best, np.arange(count)]

    def _on_the_way(self, start: np.ndarray, end: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Points at `PLACES` of the paths between points, and the log density there: (place, path, ...)."""
        places = np.array(PLACES)[:, None, None]
        way = (1.0 - places) * start + places * end
        return way, self.density(way.reshape(-1, start.shape[1])).reshape(way.shape[:2])

    def before_falls(
        self, start: np.ndarray, own_density: np.ndarray, end: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Whether the density falls between the draws and a point, the position at which it begins to fall, and its value there."""
        if not len(start):
            return np.zeros(0, dtype=bool), start, own_density
        way, density = self._on_the_way(start, end)
        falling = density[1:] < density[:-1] - VALLEY
        first = falling.argmax(axis=0)
        return np.asarray(falling.any(axis=0)), way[first, np.arange(len(start))], density[first, np.arange(len(start))]

    def divided(self, point: np.ndarray, log_density: float, mode: Mode) -> bool:
        """Whether a valley separates a point from a mode."""
        return bool(self._valleys(point[None], np.array([log_density]), mode.middle, mode.log_density)[0])

    def _valleys(
        self, start: np.ndarray, own_density: np.ndarray, end: np.ndarray, density_there: np.ndarray | float
    ) -> np.ndarray:
        """Whether the density on each path falls below the densities at both ends."""
        _, density = self._on_the_way(start, end)
        return np.asarray(density.min(axis=0) < np.minimum(own_density, density_there) - VALLEY)

    def _centres(self) -> list[tuple[np.ndarray, float]]:
        """The densest particle, then the densest particle separated from it by a valley, and so on."""
        order = np.argsort(-self.log_density, kind="stable")
        left = order[:: max(1, len(order) // 200)]
        centres: list[tuple[np.ndarray, float]] = []
        while len(left) and len(centres) < NEIGHBOURS:
            centres.append((self.particles[left[0]], float(self.log_density[left[0]])))
            left = left[self._valleys(self.particles[left], self.log_density[left], *centres[-1])]
        return centres

    def is_new(self, mode: Mode) -> bool:
        """Whether valleys separate a mode from all of the nearest particles."""
        away = ((self.particles - mode.middle) / self.particles.std(axis=0)) ** 2
        nearest = np.argsort(away.sum(axis=1))[:NEIGHBOURS]
        start = np.broadcast_to(mode.middle, (len(nearest), len(mode.middle)))
        own_density = np.full(len(nearest), mode.log_density)
        return bool(self._valleys(start, own_density, self.particles[nearest], self.log_density[nearest]).all())


def _climbed(explored: _Known, start: np.ndarray) -> Mode:
    """Climb from a point to a maximum by BFGS with central differences; one call evaluates all points of a gradient."""
    steps = STEP * np.eye(len(start))

    def falling(phi: np.ndarray) -> float:
        return float(-explored.density(phi[None])[0])

    def slope(phi: np.ndarray) -> np.ndarray:
        values = explored.density(np.concatenate([phi + steps, phi - steps])).reshape(2, -1)
        with np.errstate(invalid="ignore"):  # both may lie beyond the support
            return _finite((values[1] - values[0]) / (2.0 * STEP))

    optimum = scipy.optimize.minimize(falling, start, jac=slope, method="BFGS", options={"maxiter": 200})
    covariance = _covariance(explored, optimum.x)
    return Mode(optimum.x, -float(optimum.fun), np.linalg.cholesky(0.5 * (covariance + covariance.T)))


def _covariance(explored: _Known, middle: np.ndarray) -> np.ndarray:
    """(−∇∇ log π)⁻¹, made positive definite: second differences over steps in which log π falls by about ½."""
    own_density = explored.density(middle[None])[0]

    def second(first: np.ndarray, then: np.ndarray) -> np.ndarray:
        # f(++) − f(+−) − f(−+) + f(−−) over 4 h h'
        signs = [(1, 1), (1, -1), (-1, 1), (-1, -1)]
        values = [explored.density(middle + a * first + b * then) for a, b in signs]
        with np.errstate(invalid="ignore"):
            return np.asarray(values[0] - values[1] - values[2] + values[3])

    step = np.full(len(middle), 1e-3)
    for _ in range(3):
        fall = own_density - explored.density(np.concatenate([middle + np.diag(step), middle - np.diag(step)])).reshape(
            2, -1
        )
        step = np.clip(
            step / np.sqrt(np.maximum(2.0 * np.nan_to_num(fall, posinf=100.0).mean(axis=0), 1e-8)), 1e-8, 1.0
        )
    rows, columns = np.tril_indices(len(middle))
    half = 0.5 * np.diag(step)
    curvature = np.zeros((len(middle), len(middle)))
    curvature[rows, columns] = -second(half[rows], half[columns]) / (step[rows] * step[columns])
    curvature = _finite(curvature + np.tril(curvature, -1).T)
    # In units of the steps, in which a Gaussian's curvature is a correlation's inverse.
    values, vectors = np.linalg.eigh(curvature * np.outer(step, step))
    positive = np.clip(np.abs(values), 1e-6, 1e6)
    whole = (vectors * positive) @ vectors.T + np.diag(step**2) / WIDEST**2
    return np.asarray(np.linalg.inv(whole) * np.outer(step, step))


def _above_trend(many: np.ndarray, density: np.ndarray) -> np.ndarray:
    """Log density minus a smooth fitted function, shape (point,).

    The function is quadratic in the coordinates' ranks, which are uniform like the prior's quantiles, plus functions of single
    coordinates: third and fourth powers of the ranks, and the coordinates themselves with their squares.
    """
    ranks = scipy.stats.rankdata(many, axis=0) / len(many) - 0.5
    standard = (many - many.mean(axis=0)) / np.maximum(many.std(axis=0), np.finfo(np.float64).tiny)
    rows, columns = np.tril_indices(many.shape[1])

    def terms(part: slice) -> np.ndarray:
        u, z = ranks[part], standard[part]
        return np.concatenate([np.ones((len(u), 1)), u, u[:, rows] * u[:, columns], u**3, u**4, z, z**2], axis=1)

    some = slice(TREND * terms(slice(1)).shape[1])
    coefficients = np.linalg.lstsq(terms(some), density[some])[0]
    # In parts, since twenty parameters have 300 terms.
    trend = [terms(slice(first, first + IN_A_PART)) @ coefficients for first in range(0, len(many), IN_A_PART)]
    return np.asarray(density - np.concatenate(trend))


def _finite(array: np.ndarray) -> np.ndarray:
    """The array with zeros where a difference crosses the end of the support, and with no value whose square overflows."""
    return np.asarray(np.clip(np.nan_to_num(array, nan=0.0, posinf=0.0, neginf=0.0), -STEEPEST, STEEPEST))
