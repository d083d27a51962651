"""Choice of the next model runs: posterior draws if the surrogate is accurate there, tempered draws otherwise."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from structid.calibration.exploration import Exploration
from structid.inference.likelihood.posterior import Posterior
from structid.inference.sampling_result import SamplingResult

PLAIN_SHARE = 0.5
"""Fraction of a batch drawn from the posterior itself; its runs assess the surrogate before they train the next one."""

AHEAD = 100.0
"""Factor between the likelihood exponent up to which the surrogate is accurate and that of the next batch. A surrogate that is
uncertain in large regions is often accurate in the small region that matters."""

SCOUTS, MOST_SCOUTS = 4000, 2
"""Number of prior draws searched for points beyond all runs, and largest number of such points in a batch."""

PLAUSIBLE = 25.0
"""Largest fall of the log density, from its maximum to the edge of the runs, with which the search continues beyond the edge
[nat]. A surrogate is unreliable far outside its runs: a density that falls by this much may rise again."""

POPULATION = 4000
"""Largest number of draws that represent the posterior in a certificate."""

CANDIDATES = 200
"""Number of candidate points from which a batch is chosen."""

TEMPERED_SHARE = 1.0 / 3.0
"""Fraction of a certificate's draws that are tempered: plain draws rarely reach beyond a posterior that is too narrow."""

TEMPERATURE = 0.5
"""Exponent of the likelihood for tempered draws, which are √2 times as wide as the posterior."""


@dataclass(frozen=True, eq=False)
class Batch:
    """Points of model runs."""

    # Draws of the surrogate's posterior or of a wider density, including error-model parameters, in SI
    fresh: Float[np.ndarray, "draw parameter"]
    log_surrogate: Float[np.ndarray, " draw"]  # their log density under the surrogate
    # Weight of each draw in an average over the surrogate's posterior; one for plain draws
    shares: Float[np.ndarray, " draw"]
    others: Float[np.ndarray, "point model_parameter"]  # further points of the model's parameters, in SI
    population: Float[np.ndarray, "particle parameter"]  # many draws of the surrogate's posterior, in SI
    highest: float  # largest log density of the surrogate's posterior among them

    def points(self, dimension: int) -> Float[np.ndarray, "point model_parameter"]:
        """Return the model parameters of all points, the fresh draws first."""
        return np.concatenate([self.fresh[:, :dimension], self.others])

    def to_entry(self) -> dict[str, np.ndarray]:
        """Convert to arrays for a journal."""
        return {field.name: np.asarray(getattr(self, field.name)) for field in fields(self)}

    @classmethod
    def of(cls, entry: dict[str, np.ndarray]) -> Batch:
        """Rebuild from a journal entry; its other items are ignored."""
        fields_of_batch: dict[str, Any] = {field.name: entry[field.name] for field in fields(cls)}
        return cls(**fields_of_batch | {"highest": float(entry["highest"])})

    def of_the_errors(self, dimension: int, count: int) -> Float[np.ndarray, "draw discrepancy_parameter"]:
        """Return some draws of the error model's parameters."""
        error_parameters = self.population[:: max(1, len(self.population) // count), dimension:]
        return error_parameters[:count] if error_parameters.shape[1] else error_parameters[:1]


def certificate_draws(explored: Exploration, drawn: SamplingResult, count: int, rng: np.random.Generator) -> Batch:
    """Choose the draws of a certificate: about two thirds plain draws, one third tempered draws."""
    stage = explored.nearest(TEMPERATURE)
    wide = explored.distinct(stage, round(TEMPERED_SHARE * count), rng)
    rows = rng.permutation(np.unique(drawn.flat, axis=0, return_index=True)[1])[: count - len(wide)]
    plain = explored.posterior.bijection.inverse(drawn.flat[rows])
    phi = np.concatenate([plain, wide])
    mixed = len(plain) + len(wide) * explored.share_of_tempered(phi, stage)
    none = np.empty((0, explored.posterior.model_space.dimension))
    of_all = _batch(explored, phi, len(phi) / mixed, none)
    return replace(
        of_all, population=drawn.thinned(POPULATION), highest=float(drawn.log_density[drawn.discarded :].max())
    )


def next_batch(
    explored: Exploration,
    known: Float[np.ndarray, "run model_parameter"],
    count: int,
    rng: np.random.Generator,
    made_up: Float[np.ndarray, "draw parameter"] | None = None,
) -> Batch:
    """Choose a batch that improves the surrogate near its posterior, or on the way to it while it is inaccurate."""
    if not explored.sure:
        return _on_the_way(explored, known, count, rng)
    posterior = explored.posterior
    dimension = posterior.model_space.dimension
    plain = explored.distinct(-1, round(PLAIN_SHARE * count), rng)
    theta, _ = posterior.bijection(plain)
    points_taken = np.concatenate([known, theta[:, :dimension]])
    candidates = widened_draws(explored, CANDIDATES, rng)
    scouts = _plausible_beyond(explored, rng) if made_up is None or not len(made_up) else made_up[:, :dimension]
    if len(scouts):
        scouts = scouts[far_apart(_scores(posterior, scouts), _scores(posterior, known), MOST_SCOUTS)]
    points_taken = np.concatenate([points_taken, scouts])
    left = count - len(plain) - len(scouts)
    edges = beyond_the_runs(candidates[:, :dimension], explored.draws()[:, :dimension], points_taken)[:left]
    points_taken = np.concatenate([points_taken, candidates[edges, :dimension]])
    unsure = np.sqrt(explored.variance_at(candidates))
    unsure = np.where(np.isfinite(unsure), unsure, 0.0)
    rows = far_apart(_scores(posterior, candidates), _scores(posterior, points_taken), left - len(edges), unsure)
    others = np.concatenate([scouts, candidates[np.concatenate([edges, rows]), :dimension]])
    return _batch(explored, plain, np.ones(len(plain)), others)


def _plausible_beyond(explored: Exploration, rng: np.random.Generator) -> np.ndarray:
    """Return prior draws beyond all runs that could lie in a mode, since the density is high at the edge of the runs.

    The density is evaluated with error-model parameters from the posterior.
    """
    posterior, dimension = explored.posterior, explored.posterior.model_space.dimension
    prior = posterior.bijection(posterior.initial(SCOUTS, rng))[0][:, :dimension]
    prior = prior[explored.surrogate.outside(prior)]
    error_parameters = explored.draws()[rng.integers(len(explored.particles()), size=len(prior)), dimension:]
    theta = np.concatenate([prior, error_parameters], axis=1)
    density = posterior.log_density(theta) if len(theta) else np.empty(0)
    return np.asarray(prior[density >= explored.highest - PLAUSIBLE])


def _on_the_way(explored: Exploration, known: np.ndarray, count: int, rng: np.random.Generator) -> Batch:
    """Choose a batch from a tempered posterior; its exponent is well above the last with an accurate surrogate."""
    posterior = explored.posterior
    dimension = posterior.model_space.dimension
    ahead = max(explored.trusted + 1, explored.nearest(min(1.0, AHEAD * explored.exponents[explored.trusted])))
    trusted = explored.draws(explored.trusted)[:, :dimension]
    edges = trusted[beyond_the_runs(trusted, trusted, known)][: count // 2]
    theta = posterior.bijection(explored.distinct(ahead, CANDIDATES, rng))[0][:, :dimension]
    scores_taken = _scores(posterior, np.concatenate([known, edges]))
    others = np.concatenate([edges, theta[far_apart(_scores(posterior, theta), scores_taken, count - len(edges))]])
    return _batch(explored, np.empty((0, posterior.dimension)), np.empty(0), others)


def _batch(explored: Exploration, phi: np.ndarray, shares: np.ndarray, others: np.ndarray) -> Batch:
    """Return a batch of the fresh draws `phi`, given in unconstrained coordinates, and of the additional points `others`."""
    theta, _ = explored.posterior.bijection(phi)
    density = explored.log_density(phi) if len(phi) else np.empty(0)
    return Batch(theta, density, shares, others, explored.draws(), explored.highest)


def beyond_the_runs(
    candidates: Float[np.ndarray, "candidate parameter"],
    particles: Float[np.ndarray, "draw parameter"],
    known: Float[np.ndarray, "run parameter"],
) -> Int[np.ndarray, " point"]:
    """Choose the furthest candidate in each direction in which a posterior reaches beyond all runs.

    Beyond its runs a surrogate appears as certain as among them, so that its standard deviation gives no warning.
    """
    above = particles.max(axis=0) > known.max(axis=0)
    below = particles.min(axis=0) < known.min(axis=0)
    rows = np.concatenate([candidates.argmax(axis=0)[above], candidates.argmin(axis=0)[below]])
    return np.unique(rows).astype(int)


def widened_draws(explored: Exploration, count: int, rng: np.random.Generator) -> Float[np.ndarray, "count parameter"]:
    """Draw from a distribution like the posterior but √3 times as wide: φ + φ′ − φ″ of three draws."""
    phi = explored.particles()
    first, second, third = (phi[rng.integers(len(phi), size=count)] for _ in range(3))
    return explored.posterior.bijection(first + second - third)[0]


def _scores(posterior: Posterior, theta: np.ndarray) -> np.ndarray:
    """Return the prior cumulative probabilities of the model's parameters, which have a common scale."""
    space = posterior.model_space
    return space.cdf(theta[:, : space.dimension])


def far_apart(
    candidates: Float[np.ndarray, "candidate parameter"],
    known: Float[np.ndarray, "point parameter"],
    count: int,
    weights: Float[np.ndarray, " candidate"] | None = None,
) -> Int[np.ndarray, " count"]:
    """Choose points one by one, each with the largest weighted distance to all known and chosen points."""
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
