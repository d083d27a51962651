"""Errors of the moments of draws, and a test of the draws, by Stein's identity; their density is known only at the draws.

Over draws from a density q that falls to zero, every smooth function g fulfils

E_q[g ∂ log q/∂z_j + ∂g/∂z_j] = 0

(C. Stein 1972, Proc. 6th Berkeley Symp. 2, 583–602; as a test of samples J. Gorham & L. Mackey 2015, Advances in Neural
Information Processing Systems 28). Constant and linear g show the moments of q. With the scores s = ∂ log q/∂z, their regression
on z has the slope −P: P⁻¹ is the covariance of q, and E[z] + P⁻¹ E[s] its mean. This is exact for a normal q, whatever draws are
given, and for draws from q, whatever q is. Functions g from a kernel show other differences (K. Chwialkowski, H. Strathmann &
A. Gretton 2016, Proc. 33rd ICML). A mode far from all draws is not detected.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from jaxtyping import Float

from structid.certification.certificate import number_in_words
from structid.certification.external.drawn_density import DrawnDensity
from structid.certification.external.scores_at_draws import (
    COMPARED,
    Coordinates,
    Interpolation,
    Scores,
    covariance_of,
    power_of,
)
from structid.certification.limits import Limits
from structid.certification.monte_carlo_error import MonteCarloError, simultaneous_quantile

LEAST_SHARE = 0.5
"""Share of the draws that the weights must leave effective for a decision."""
RARE = 0.0005
"""Probability of what was observed, over draws of q, below which the draws are refused."""
LACKING = "The draws lack a part of q, or their chain has not converged"
UNDECIDED = "the values of the given density at the draws cannot decide whether the draws follow it (Stein's identity)"


@dataclass(frozen=True, eq=False)
class Deviation:
    """By how much the moments of draws differ from those of their density, and the error of these differences."""

    mean: Float[np.ndarray, " parameter"]  # in standard deviations of q
    sd: Float[np.ndarray, " parameter"]  # relative to that of q
    correlation: Float[np.ndarray, "parameter parameter"]

    @property
    def kinds(self) -> tuple[np.ndarray, ...]:
        """All differences."""
        return self.mean, self.sd, self.correlation


@dataclass(frozen=True, eq=False)
class SteinTest:
    """What Stein's identity says of draws.

    Parameters
    ----------
    deviation, error : Deviation
        Differences of the moments of the draws from those of q, and the errors of these differences, with a confidence.
    shift, widening : float
        Largest difference of the mean along any direction, in standard deviations, and largest relative one of the
        standard deviation.
    moment_probability, kernel_probability : float
        Probabilities, over draws of q, of averages and of a kernel Stein discrepancy as large as those of the draws.
    effective_share : float
        Share of the draws that the weights leave effective.
    """

    deviation: Deviation
    error: Deviation
    shift: float
    widening: float
    moment_probability: float
    kernel_probability: float
    effective_share: float

    @classmethod
    def of(
        cls, drawn: DrawnDensity, interpolation: Interpolation, by_chance: MonteCarloError, rng: np.random.Generator
    ) -> SteinTest:
        """Test draws whose Monte Carlo error is known."""
        coordinates, scores = interpolation.coordinates, Scores.of(drawn, interpolation)
        z = coordinates.standard(drawn.phi)
        compared = partial(_compared, drawn, coordinates)
        of_q = scores.moments_of_q
        some = z[:: max(1, len(z) // COMPARED)]
        jackknife = [
            _deviation(compared, some, *scores[scores.blocks != block].moments_of_q)
            for block in np.unique(scores.blocks)
        ]
        matrix = power_of(of_q[1], -0.5)
        independent = by_chance.size * min(1.0, len(scores.z) / len(z))
        return cls(
            _deviation(compared, z, *of_q),
            _error(jackknife, by_chance.confidence),
            float(np.linalg.norm(matrix @ of_q[0])),
            float(np.abs(np.linalg.eigvalsh(matrix) - 1.0).max()),
            scores.moment_probability(independent, rng),
            scores.kernel_probability(independent, rng),
            scores.effective_share,
        )

    def added_to(self, by_chance: MonteCarloError) -> MonteCarloError:
        """Return bounds on the errors of the moments that hold by the number of the draws and by Stein's identity."""
        mean, sd, correlation = (
            np.maximum(of_chance, np.abs(deviation) + error)
            for of_chance, deviation, error in zip(
                (by_chance.mean, by_chance.sd, by_chance.correlation),
                self.deviation.kinds,
                self.error.kinds,
                strict=True,
            )
        )
        return replace(by_chance, mean=mean, sd=sd, correlation=correlation, by_stein=(self.shift, self.widening))

    def contradicts(self, limits: Limits) -> bool:
        """Whether the draws do not follow their density."""
        decided = self.effective_share >= LEAST_SHARE
        return decided and (self._moments_contradict(limits) or self.kernel_probability < RARE)

    def _moments_contradict(self, limits: Limits) -> bool:
        return self._worst(limits, -1.0).times > 1.0 and self.moment_probability < RARE

    def doubts(self, limits: Limits, names: tuple[str, ...]) -> tuple[str, ...]:
        """Explain why the draws do not follow their density, or why this cannot be decided; empty otherwise."""
        if self.effective_share < LEAST_SHARE:
            return (
                f"{UNDECIDED}: a surrogate of log q, which gives its gradient, agrees with it at only "
                f"{self.effective_share:.1%} of the draws. Give the density as a function",
            )
        certain, possible = self._worst(limits, -1.0), self._worst(limits, 1.0)
        if self._moments_contradict(limits):
            return (
                "these are not draws of the given density q: by its gradient at the draws (Stein's identity), "
                f"{certain.finding(names, 'is wrong by at least')}. {LACKING}",
            )
        if self.kernel_probability < RARE:
            return (
                "these are not draws of the given density q: draws of q have such a kernel Stein discrepancy with a "
                f"probability of less than {RARE:.2%}. {LACKING}",
            )
        if possible.times > 1.0:
            return (
                f"{UNDECIDED}: {possible.finding(names, 'may be wrong by')}. Give the density as a function, or more draws",
            )
        return ()

    def _worst(self, limits: Limits, errors: float) -> _Finding:
        """The difference that exceeds its limit most, with a multiple of its error."""
        found = []
        for word, unit, deviation, error, limit in zip(
            ("mean", "standard deviation", "correlation"),
            (" standard deviations", " of its value", ""),
            self.deviation.kinds,
            self.error.kinds,
            (limits.mean, limits.sd, limits.correlation),
            strict=True,
        ):
            # A difference that overflows may have any size, and proves nothing.
            size = np.nan_to_num(np.abs(deviation) + errors * error, nan=np.inf if errors > 0.0 else 0.0, posinf=np.inf)
            place = np.unravel_index(int(np.argmax(size)), size.shape)
            found.append(_Finding(word, unit, float(size[place]), limit, tuple(map(int, place))))
        return max(found, key=lambda finding: finding.times)


@dataclass(frozen=True)
class _Finding:
    """A difference between draws and their density."""

    word: str
    unit: str
    size: float
    limit: float
    place: tuple[int, ...]

    @property
    def times(self) -> float:
        """Multiple of the limit."""
        return self.size / self.limit

    def finding(self, names: tuple[str, ...], verb: str) -> str:
        """The difference in words."""
        whose = " and ".join(names[place] for place in self.place)
        return f"the {self.word} of {whose} {verb} {number_in_words(self.size)}{self.unit}; the limit is {self.limit:g}"


def _compared(drawn: DrawnDensity, coordinates: Coordinates, z: np.ndarray) -> np.ndarray:
    """The parameters whose moments are certified."""
    return drawn.posterior.compared(drawn.bijection(coordinates.phi(z))[0])


def _deviation(
    compared: Callable[[np.ndarray], np.ndarray], z: np.ndarray, mean: np.ndarray, covariance: np.ndarray
) -> Deviation:
    """Differences of the moments of draws from those of the same draws with another mean and covariance."""
    equal = np.full(len(z), 1.0 / len(z))
    own = covariance_of(z, equal)
    # Of all maps between two covariances, the symmetric one moves the draws least.
    root, inverse = power_of(own, 0.5), power_of(own, -0.5)
    matrix = inverse @ power_of(root @ covariance @ root, 0.5) @ inverse
    moved = mean + (z - z.mean(axis=0)) @ matrix
    given, of_q = (_moments(compared(points)) for points in (z, moved))
    return Deviation((given[0] - of_q[0]) / of_q[1], given[1] / of_q[1] - 1.0, given[2] - of_q[2])


def _error(jackknife: list[Deviation], confidence: float) -> Deviation:
    """Error of a deviation from its values without each block of draws in turn."""
    count, errors = len(jackknife), []
    for values in zip(*(deviation.kinds for deviation in jackknife), strict=True):
        among = np.array(values)
        sd = np.sqrt((count - 1) ** 2 / count * among.var(axis=0, ddof=1))
        errors.append(simultaneous_quantile(confidence, max(among[0].size, 1)) * sd)
    return Deviation(*errors)


def _moments(points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Means, standard deviations and correlations."""
    sd = points.std(axis=0)
    covariance = np.atleast_2d(np.cov(points.T, bias=True))
    return points.mean(axis=0), sd, covariance / np.outer(sd, sd)
