"""Convergence diagnostics: autocorrelation time, effective sample size, R-hat over independent ensembles, stuck walkers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from jaxtyping import Bool, Float

from structid.probability.ranks import ranks

STUCK_ACCEPTANCE = 0.2
"""A walker whose acceptance is below this fraction of the median walker's is stuck."""
LAST_STEPS = 20
"""Minimum number of final steps searched for walkers whose density is far below the others'."""
IN_TURN, ERRORS_OF_CHANCE = 0.1, 6.0
"""Autocorrelation that reveals alternating walkers: a constant plus this many standard errors. Below 0.1, τ is at most
1.2."""
FEWEST_MOVES = 50
"""The acceptance of a walker is assessed only if the median walker has at least this many accepted moves."""


def autocorrelation_time(series: Float[np.ndarray, "series step"], window: float = 5.0) -> float:
    """Integrated autocorrelation time, τ = 1 + 2 Σ (1 − t/S) ρ(t) over S steps, with Sokal's window.

    The sum ends at the first lag M ≥ `window` · τ(M) (Sokal 1997). The autocorrelations of several series are averaged
    first, since each alone is noisy. Every series is centred on the mean of all series. If it were centred on its own
    mean, a series not much longer than τ would show too little correlation. The overall mean of E series has a variance
    V, so each autocovariance is too small by V. With V = (Σ C(t) + V Σ (1 − |t|/S)) / (E S), the sum is divided by 1 −
    Σ (1 − |t|/S) / (E S).
    """
    return _time_and_error(series, window)[0]


def _time_and_error(series: np.ndarray, window: float = 5.0) -> tuple[float, float]:
    """τ of `autocorrelation_time`, and its standard error, τ √(2 (2M + 1) / (E S)) (Madras & Sokal 1988)."""
    series = np.atleast_2d(series)
    count, steps = series.shape
    transform = np.fft.rfft(series - series.mean(), n=2 * steps, axis=1)
    covariance = np.fft.irfft((np.abs(transform) ** 2).mean(axis=0))[:steps]
    if np.ptp(series) == 0.0:
        return float("nan"), float("nan")
    sums = 2.0 * np.cumsum(covariance / covariance[0]) - 1.0
    lags = np.arange(steps)
    long_enough = np.flatnonzero(lags >= window * sums)
    last = long_enough[0] if long_enough.size else steps - 1
    window_sum = 1.0 + 2.0 * np.sum(1.0 - lags[1 : last + 1] / steps)
    time = float(max(sums[last] / max(1.0 - window_sum / (count * steps), 1.0 / steps), 1.0))
    return time, time * float(np.sqrt(2.0 * (2 * last + 1) / (count * steps)))


def autocovariance(series: Float[np.ndarray, "time quantity"]) -> Float[np.ndarray, "lag quantity"]:
    """Sums of lagged products, Σ_t (x_t − x̄)(x_{t+k} − x̄)."""
    return lagged_products(series - series.mean(axis=0))


def lagged_products(series: Float[np.ndarray, "time quantity"]) -> Float[np.ndarray, "lag quantity"]:
    """Σ_t x_t x_{t+k} for the lags k = 0, 1, …."""
    samples = len(series)
    transform = np.fft.rfft(series, 2 * samples, axis=0)
    return np.fft.irfft(np.abs(transform) ** 2, axis=0)[:samples]


def walkers_in_turn(draws: Float[np.ndarray, "draw parameter"]) -> int:
    """Number of walkers whose draws alternate in an apparently single chain: w_1(1), w_2(1), …, w_1(2), w_2(2) and so on.

    Neighbouring draws are then independent. Draws of the same walker are this many draws apart, and correlated.
    """
    covariance = autocovariance(draws)
    correlation = np.mean(covariance / covariance[0], axis=1)
    threshold = IN_TURN + ERRORS_OF_CHANCE / np.sqrt(draws.size)
    apart = np.flatnonzero(correlation > threshold)[1:]
    return int(apart[0]) if apart.size and apart[0] > 1 else 1


def weighted_size(weights: Float[np.ndarray, " draw"]) -> float:
    """Effective number of weighted draws by Kish's measure, (Σw)²/Σw²."""
    return float(np.sum(weights) ** 2 / np.sum(weights**2))


def effective_sample_size(draws: Float[np.ndarray, "step ensemble walker"]) -> float:
    """Effective number of independent draws for the mean of a quantity.

    Walkers of a stationary ensemble are independent at any one step, so the mean over walkers has the variance σ²/W, and
    ESS = E · W · S/τ, with τ from `series_time`.
    """
    return draws.size / series_time(draws)


def standard_error(draws: Float[np.ndarray, "step ensemble walker"]) -> float:
    """Standard error of a mean: the larger of two estimates, from effective sample size and from ensemble means."""
    of_ensembles = draws.mean(axis=(0, 2))
    by_size = draws.var() / max(effective_sample_size(draws), 1.0) if np.ptp(draws) else 0.0
    by_ensembles = of_ensembles.var(ddof=1) / len(of_ensembles) if len(of_ensembles) > 1 else 0.0
    return float(np.sqrt(max(by_size, by_ensembles)))


def series_time(draws: Float[np.ndarray, "step ensemble walker"]) -> float:
    """Integrated autocorrelation time of a quantity, which determines the standard error of its mean.

    The relevant τ is the autocorrelation time of each ensemble's mean. Few ensembles determine it poorly: if τ = 60,
    300 steps give it only to within a factor of four. The many walkers determine their own τ well, but not their
    dependence on one another. The result is therefore the walkers' τ plus a fraction of the difference d by which the
    means' τ exceeds it. With the standard error s of the means' τ, this fraction is (1 − s²/d²)₊ (the non-negative
    garrote, L. Breiman 1995, doi 10.1080/00401706.1995.10484371). For chains shorter than about ten τ, only the walkers
    are used: see `longest_time`.
    """
    alone, together, error = _times_alone_and_together(draws)
    beyond = together - alone
    return alone + (beyond - error**2 / beyond if beyond > error else 0.0)


def longest_time(draws: Float[np.ndarray, "step ensemble walker"]) -> float:
    """Autocorrelation time that sets the required chain length: the longer of the walkers' and the ensemble means'."""
    alone, together, _ = _times_alone_and_together(draws)
    return float(np.fmax(alone, together))


def _times_alone_and_together(draws: np.ndarray) -> tuple[float, float, float]:
    """τ of the walkers, τ of the ensemble means, and the standard error of the second."""
    return autocorrelation_time(draws.reshape(len(draws), -1).T), *_time_and_error(draws.mean(axis=2).T)


def bulk_and_tail_size(draws: Float[np.ndarray, "step ensemble walker"]) -> tuple[float, float]:
    """Effective sample sizes: of the rank-normalised draws, and the smaller of those of the 5 and 95 % quantiles."""
    return effective_sample_size(normal_scores(draws)), _size_beyond(draws, 0.05)


def _size_beyond(draws: np.ndarray, share: float) -> float:
    """The smaller of the effective sample sizes of both tails; each tail contains the fraction `share` of the draws."""
    return min(effective_sample_size((draws <= q).astype(np.float64)) for q in np.quantile(draws, [share, 1.0 - share]))


def r_hat(draws: Float[np.ndarray, "step ensemble walker"]) -> float:
    """Rank-normalised split R-hat over ensembles; the walkers of an ensemble are pooled.

    Walkers of one ensemble depend on each other; ensembles are independent chains.
    """
    steps, ensembles, walkers = draws.shape
    if ensembles < 2:
        return float("nan")
    # The draws are ordered by step, so that the halves are halves in time.
    chains, half = draws.transpose(1, 0, 2).reshape(ensembles, steps * walkers), steps * walkers // 2
    halves = np.concatenate([chains[:, :half], chains[:, -half:]])
    return max(_r_hat_of_scores(halves), _r_hat_of_scores(np.abs(halves - np.median(halves))))


def _r_hat_of_scores(chains: np.ndarray) -> float:
    """√{[(N − 1) W + B]/(N W)} of normal scores (chain, N): W their mean variance, B/N the variance of their means."""
    scores, length = normal_scores(chains), chains.shape[1]
    with np.errstate(all="ignore"):
        ratio = length * scores.mean(axis=1).var(ddof=1) / scores.var(axis=1, ddof=1).mean()
        return float(np.sqrt((length - 1.0 + ratio) / length))


def normal_scores(draws: np.ndarray) -> np.ndarray:
    """Normal quantiles of the ranks of draws, Φ⁻¹((rank − 3/8)/(S + 1/4))."""
    return np.asarray(scipy.special.ndtri((ranks(draws) - 0.375) / (draws.size + 0.25)))


def stuck_walkers(
    accepted: Bool[np.ndarray, "step ensemble walker"], log_density: Float[np.ndarray, "step ensemble walker"]
) -> Bool[np.ndarray, "ensemble walker"]:
    """Walkers that hardly move, or whose last log density is far below the others'."""
    rate = accepted.mean(axis=0)
    # Where few moves are expected, a low count may be chance.
    telling = np.median(rate) * len(accepted) >= FEWEST_MOVES
    slow = telling & (rate < STUCK_ACCEPTANCE * np.median(rate))
    last = log_density[-max(len(log_density) // 5, LAST_STEPS) :]
    best = last.max(axis=0)
    healthy = last[:, best >= np.quantile(best, 0.25)]
    return np.asarray(slow | (best < healthy.min()))


@dataclass(frozen=True)
class ParameterDiagnostics:
    """Diagnostics of one parameter."""

    r_hat: float  # over ensembles
    autocorrelation_time: float  # τ in steps; see `longest_time`
    bulk_size: float  # effective sample size of the rank-normalised draws
    tail_size: float  # effective sample size of the 5 and 95 % quantiles
    far_tail_size: float  # effective sample size of the 1 and 99 % quantiles


def parameter_diagnostics(draws: Float[np.ndarray, "step ensemble walker"]) -> ParameterDiagnostics:
    """All diagnostics of one parameter."""
    bulk, tail = bulk_and_tail_size(draws)
    return ParameterDiagnostics(r_hat(draws), longest_time(draws), bulk, tail, _size_beyond(draws, 0.01))
