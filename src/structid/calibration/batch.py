"""Which true runs to do next: draws of the posterior, where its surrogate is least sure, and where it has not been."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from structid.inference.likelihood.posterior import Posterior
from structid.inference.sampling.sampler import Block
from structid.surrogates.face import Surrogate

FRESH_SHARE = 0.4
"""Share of a batch that are plain draws of the posterior: they show how good its surrogate is before they improve it."""

WIDENED_SHARE = 0.4
"""Share of a batch that are widened draws, chosen where the surrogate is least sure; the rest are tempered draws."""

TEMPERATURES = (0.3, 0.1)
"""Exponents of the likelihood for tempered draws, which are about two and three times as wide as the posterior."""

CANDIDATES = 200
"""Draws among which the surrogate's own standard deviation is compared."""


@dataclass(frozen=True, eq=False)
class Batch:
    """Points of true runs.

    Parameters
    ----------
    fresh : ndarray, shape (draw, parameter)
        Draws of the surrogate's posterior, discrepancy parameters included, in SI.
    log_surrogate : ndarray, shape (draw,)
        Their log density under the surrogate.
    others : ndarray, shape (point, model parameter)
        Further points of the model's parameters, in SI.
    """

    fresh: np.ndarray
    log_surrogate: np.ndarray
    others: np.ndarray

    def points(self, dimension: int) -> np.ndarray:
        """All points of the model's parameters, the fresh draws first.

        Parameters
        ----------
        dimension : int
            Number of the model's parameters, which come first among a posterior's.

        Returns
        -------
        ndarray, shape (point, model parameter)
            In SI.
        """
        return np.concatenate([self.fresh[:, :dimension], self.others])


def fresh_draws(posterior: Posterior, particles: Block, count: int, rng: np.random.Generator) -> Batch:
    """Choose plain draws among the last particles of a sampler.

    Parameters
    ----------
    posterior : Posterior
        Under the surrogate.
    particles : dict
        The sampler's last block.
    count : int
        How many.
    rng : numpy.random.Generator
        Source of randomness.

    Returns
    -------
    Batch
        Without others.
    """
    phi = _last(posterior, particles)
    phi = phi[rng.permutation(len(phi))]
    # Particles that were drawn twice and have not moved since are one: a point is run once.
    distinct = np.sort(np.unique(phi, axis=0, return_index=True)[1])
    theta, jacobian = posterior.bijection(phi[distinct[:count]])
    log_density, _ = posterior.evaluate(phi[distinct[:count]])
    others = np.empty((0, posterior.model_space.dimension))
    return Batch(theta, log_density - jacobian, others)


def next_batch(
    posterior: Posterior,
    surrogate: Surrogate,
    blocks: list[Block],
    known: np.ndarray,
    count: int,
    rng: np.random.Generator,
) -> Batch:
    """Choose a batch that improves the surrogate where its posterior is.

    Parameters
    ----------
    posterior : Posterior
        Under the surrogate.
    surrogate : Surrogate
        Its model.
    blocks : list of dict
        All blocks of the tempered sampler.
    known : ndarray, shape (run, model parameter)
        Points of earlier true runs.
    count : int
        How many.
    rng : numpy.random.Generator
        Source of randomness.

    Returns
    -------
    Batch
        `FRESH_SHARE` are plain draws. `WIDENED_SHARE` are draws of a law wider than the posterior, since a surrogate is worst at
        the edge of its runs: first those that bring the posterior inside the range of the runs, then those where the surrogate's
        standard deviation times the distance to known points is largest. The rest come from tempered posteriors, as far as
        possible from known points.
    """
    fresh, widened = round(FRESH_SHARE * count), round(WIDENED_SHARE * count)
    plain = fresh_draws(posterior, blocks[-1], fresh, rng)
    dimension = posterior.model_space.dimension
    taken = np.concatenate([known, plain.fresh[:, :dimension]])
    candidates = widened_draws(posterior, blocks[-1], CANDIDATES, rng)
    particles = posterior.bijection(_last(posterior, blocks[-1]))[0]
    edges = beyond_the_runs(candidates[:, :dimension], particles[:, :dimension], taken)[:widened]
    taken = np.concatenate([taken, candidates[edges, :dimension]])
    deviation = relative_deviation(posterior, surrogate, candidates)
    rows = far_apart(_scores(posterior, candidates), _scores(posterior, taken), widened - len(edges), deviation)
    unsure = candidates[np.concatenate([edges, rows]), :dimension]
    taken = np.concatenate([taken, unsure])
    tempered = tempered_draws(posterior, blocks, taken, count - fresh - widened, rng)
    return replace(plain, others=np.concatenate([unsure, tempered]))


def beyond_the_runs(candidates: np.ndarray, particles: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Choose the candidate furthest out in each direction in which a posterior reaches beyond all runs.

    Out there a surrogate responds as at the edge and is as sure of itself as at the edge, so its standard deviation gives no
    warning.

    Parameters
    ----------
    candidates : ndarray, shape (candidate, parameter)
        To choose from.
    particles : ndarray, shape (draw, parameter)
        Draws of the posterior.
    known : ndarray, shape (run, parameter)
        Points of the runs.

    Returns
    -------
    ndarray of int, shape (point,)
        Distinct rows of the candidates: up to two a parameter.
    """
    above = particles.max(axis=0) > known.max(axis=0)
    below = particles.min(axis=0) < known.min(axis=0)
    rows = np.concatenate([candidates.argmax(axis=0)[above], candidates.argmin(axis=0)[below]])
    return np.unique(rows).astype(int)


def widened_draws(posterior: Posterior, particles: Block, count: int, rng: np.random.Generator) -> np.ndarray:
    """Draw from a law like the posterior but √3 times as wide: φ + φ′ − φ″ of three draws.

    Parameters
    ----------
    posterior : Posterior
        Under the surrogate.
    particles : dict
        The sampler's last block.
    count : int
        How many.
    rng : numpy.random.Generator
        Source of randomness.

    Returns
    -------
    ndarray, shape (count, parameter)
        In SI.
    """
    phi = _last(posterior, particles)
    first, second, third = (phi[rng.integers(len(phi), size=count)] for _ in range(3))
    return posterior.bijection(first + second - third)[0]


def tempered_draws(
    posterior: Posterior, blocks: list[Block], known: np.ndarray, count: int, rng: np.random.Generator
) -> np.ndarray:
    """Choose draws of tempered posteriors, as far as possible from what is known and from one another.

    Parameters
    ----------
    posterior : Posterior
        Under the surrogate.
    blocks : list of dict
        All blocks of the tempered sampler.
    known : ndarray, shape (run, model parameter)
        Points of earlier true runs.
    count : int
        How many.
    rng : numpy.random.Generator
        Source of randomness.

    Returns
    -------
    ndarray, shape (count, model parameter)
        In SI.
    """
    exponents = np.maximum([b["exponent"][-1] for b in blocks], 1e-300)
    dimension = posterior.model_space.dimension
    found: list[np.ndarray] = []
    for share, temperature in zip(_shares(count, len(TEMPERATURES)), TEMPERATURES, strict=True):
        stage = blocks[int(np.argmin(np.abs(np.log(exponents / temperature))))]
        phi = _last(posterior, stage)
        theta, _ = posterior.bijection(phi[rng.permutation(len(phi))[: 10 * CANDIDATES]])
        theta = theta[:, :dimension]
        taken = np.concatenate([known, *found])
        found.append(theta[far_apart(_scores(posterior, theta), _scores(posterior, taken), share)])
    return np.concatenate(found)


def _last(posterior: Posterior, particles: Block) -> np.ndarray:
    """Where the particles of a block are at its end, in unconstrained coordinates, shape (particle, parameter)."""
    return np.asarray(particles["phi"][-1].reshape(-1, posterior.dimension))


def _shares(count: int, parts: int) -> list[int]:
    return [count // parts + (i < count % parts) for i in range(parts)]


def _scores(posterior: Posterior, theta: np.ndarray) -> np.ndarray:
    """The model's parameters as probabilities under the prior: comparable with one another."""
    space = posterior.model_space
    return space.cdf(theta[:, : space.dimension])


def far_apart(candidates: np.ndarray, known: np.ndarray, count: int, weights: np.ndarray | None = None) -> np.ndarray:
    """Choose points one by one, each time the one with the largest weighted distance to all known and chosen points.

    Parameters
    ----------
    candidates : ndarray, shape (candidate, parameter)
        To choose from.
    known : ndarray, shape (point, parameter)
        What is there.
    count : int
        How many to choose.
    weights : ndarray, shape (candidate,), optional
        What distances are multiplied by.

    Returns
    -------
    ndarray of int, shape (count,)
        Rows of the candidates.
    """
    sd = candidates.std(axis=0)
    scale = np.where(sd > 0, sd, 1.0)
    points, others = candidates / scale, known / scale
    distance = np.full(len(points), np.inf)
    for other in others:
        distance = np.minimum(distance, np.linalg.norm(points - other, axis=1))
    if not len(others):
        distance = np.linalg.norm(points - points.mean(axis=0), axis=1)
    weights = np.ones(len(points)) if weights is None else weights
    chosen: list[int] = []
    for _ in range(min(count, len(points))):
        best = int(np.argmax(weights * distance))
        chosen.append(best)
        distance = np.minimum(distance, np.linalg.norm(points - points[best], axis=1))
    return np.array(chosen, dtype=int)


def relative_deviation(posterior: Posterior, surrogate: Surrogate, theta: np.ndarray) -> np.ndarray:
    """The surrogate's own standard deviation relative to its prediction, over all measurements.

    Parameters
    ----------
    posterior : Posterior
        With the measurements.
    surrogate : Surrogate
        The model.
    theta : ndarray, shape (run, parameter)
        Points in SI.

    Returns
    -------
    ndarray, shape (run,)
        Root mean square over time, channels and measurements.
    """
    parameters = np.asarray(posterior.model_parameters(theta))
    total = np.zeros(len(theta))
    for observation in posterior.observations:
        values = surrogate.run(parameters, observation.record).values
        deviation = surrogate.standard_deviation(parameters, observation.record, values)
        size = np.sqrt(np.mean(values**2, axis=1, keepdims=True))
        total += np.nanmean((deviation / np.where(size > 0, size, 1.0)) ** 2, axis=(1, 2))
    return np.sqrt(np.where(np.isfinite(total), total, 0.0))
