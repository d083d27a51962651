"""Errors of averages over draws, from their number and, where Stein's identity shows more, from their density."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from jaxtyping import Float

from structid.certification.limits import Limits
from structid.inference.convergence import standard_error


@dataclass(frozen=True, eq=False)
class MonteCarloError:
    """Bounds on the errors of the moments of draws, beside those of their density, with the confidence of a certificate."""

    mean: Float[np.ndarray, " parameter"]  # of every mean, in standard deviations
    sd: Float[np.ndarray, " parameter"]  # of every standard deviation, relative to it
    correlation: Float[np.ndarray, "parameter parameter"]  # of every correlation
    size: float  # number of independent draws with the same error as the least certain mean
    confidence: float  # simultaneous confidence
    # Largest differences of draws from their density along any direction, by Stein's identity, where the density is known only at
    # the draws: of the mean, in standard deviations, and of the standard deviation, relative to it
    by_stein: tuple[float, float] | None = None

    @classmethod
    def of(cls, draws: Float[np.ndarray, "chain draw parameter"], confidence: float) -> MonteCarloError:
        """Estimate the error from the draws in the order in which they were drawn.

        By the central limit theorem for chains, the mean of a function f over draws has an error of at most its standard error
        times a normal quantile. With z the standardised parameters, f is z_j for a mean, ½ z_j² for a standard deviation, and for
        a correlation ρ, to first order, z_i z_j − ½ ρ (z_i² + z_j²).
        """
        dimension = draws.shape[2]
        z = (draws - draws.mean(axis=(0, 1))) / draws.std(axis=(0, 1))
        of_mean = np.array([_error(z[..., j]) for j in range(dimension)])
        of_sd = np.array([_error(0.5 * z[..., j] ** 2) for j in range(dimension)])
        of_correlation = np.zeros((dimension, dimension))
        for i, j in zip(*np.triu_indices(dimension, 1), strict=True):
            rho = np.mean(z[..., i] * z[..., j])
            error = _error(z[..., i] * z[..., j] - 0.5 * rho * (z[..., i] ** 2 + z[..., j] ** 2))
            of_correlation[i, j] = of_correlation[j, i] = error
        counts = dimension, max(dimension * (dimension - 1) // 2, 1)
        one, pairs = (simultaneous_quantile(confidence, count) for count in counts)
        return cls(one * of_mean, one * of_sd, pairs * of_correlation, float(of_mean.max() ** -2), confidence)

    def of_probability(self, p: float) -> float:
        """Bound on the difference between the fraction of draws in an event and its probability.

        A normal density that is shifted by δ and wider by η changes the probability of x > t by φ(t) (δ + η |t|).
        """
        by_number = simultaneous_quantile(self.confidence, 1) * float(np.sqrt(p * (1.0 - p) / self.size))
        if self.by_stein is None:
            return by_number
        (shift, widening), t = self.by_stein, float(scipy.stats.norm.isf(p))
        return max(by_number, float(scipy.stats.norm.pdf(t)) * (shift + widening * abs(t)))

    def too_large(self, limits: Limits, names: tuple[str, ...]) -> tuple[str, ...]:
        """Report if there are too few draws for the limits, whatever their density."""
        of_correlation = self.correlation.max(axis=1)
        kinds = [
            (
                self.mean / limits.mean,
                "the mean",
                [f"{x:.2g} standard deviations" for x in self.mean],
                f"{limits.mean:g}",
            ),
            (self.sd / limits.sd, "the standard deviation", [f"{x:.0%}" for x in self.sd], f"{limits.sd:.0%}"),
            (
                of_correlation / limits.correlation,
                "a correlation",
                [f"{x:.2g}" for x in of_correlation],
                f"{limits.correlation:g}",
            ),
        ]
        times, kind, off, allowed = max(kinds, key=lambda kind: float(kind[0].max()))
        worst = int(np.argmax(times))
        if times[worst] <= 1.0:
            return ()
        return (
            f"there are too few draws: they count as {self.size:.0f} independent draws, so that {kind} of {names[worst]} may have "
            f"a Monte Carlo error of {off[worst]}; the limit is {allowed}; draw "
            f"{max(times[worst] ** 2, 1.1):.2g} times as many",
        )


def _error(values: np.ndarray) -> float:
    """Standard error of the mean of values (chain, draw); chains are independent."""
    return standard_error(values.T[:, :, None])


def simultaneous_quantile(confidence: float, count: int) -> float:
    """Return the normal quantile for a number of simultaneous two-sided statements."""
    return float(scipy.stats.norm.ppf(1.0 - 0.5 * (1.0 - confidence) / count))
