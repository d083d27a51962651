"""Has it converged? Autocorrelation time, effective sample size, R-hat over independent ensembles, stuck walkers."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import scipy

from structid.notebook import ShownAsText

R_HAT_LIMIT = 1.01
"""Largest R-hat of a converged run (Vehtari et al. 2021)."""
EFFECTIVE_SIZE_LIMIT = 400
"""Smallest bulk and tail effective sample size of a converged run."""
STUCK_ACCEPTANCE = 0.2
"""A walker whose acceptance is below this fraction of the median walker's is stuck."""
LAST_STEPS = 20
"""Smallest number of steps searched for walkers that end far below the others."""
FEWEST_MOVES = 50
"""A walker is judged by its acceptance only if the median walker has at least this many accepted moves."""
BOUND_WIDTH = 0.02
"""The strip along a prior bound, as a fraction of the range between the prior's 5 and 95 % quantiles."""
BOUND_MASS = 0.2
"""A marginal is said to sit on the bound if it has at least this posterior mass in that strip."""
TAILS = (0.01, 0.99)
"""Quantiles beyond which draws are compared with an independent population."""
ERRORS_APART = 5.0
"""Standard errors by which they may differ: the largest of some dozens of comparisons."""
TAIL_PROBABILITY = 1e-3
"""A posterior median beyond this prior probability says that prior and data disagree."""


def autocorrelation_time(series: np.ndarray, window: float = 5.0) -> float:
    """Integrated autocorrelation time, τ = 1 + 2 Σ (1 − t/S) ρ(t) over S steps, with Sokal's window.

    The sum ends at the first lag M ≥ `window` · τ(M) (Sokal 1997). The autocorrelations of several series are averaged first,
    since each alone is noisy. They are taken about the mean of all series. About its own mean, a series not much longer than τ
    hides part of its correlation. The mean of E series has a variance V itself, by which each autocovariance comes out too small.
    With V = (Σ C(t) + V Σ (1 − |t|/S)) / (E S), the sum is divided by 1 − Σ (1 − |t|/S) / (E S).

    Parameters
    ----------
    series : ndarray, shape (series, step)
        Independent, equally long series.
    window : float
        Length of the window in τ.

    Returns
    -------
    float
        τ in steps, at least 1; NaN for a constant series.
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
    seen = 1.0 + 2.0 * np.sum(1.0 - lags[1 : last + 1] / steps)
    time = float(max(sums[last] / max(1.0 - seen / (count * steps), 1.0 / steps), 1.0))
    return time, time * float(np.sqrt(2.0 * (2 * last + 1) / (count * steps)))


def weighted_size(weights: np.ndarray) -> float:
    """Effective number of weighted draws by Kish's measure, (Σw)²/Σw².

    Parameters
    ----------
    weights : ndarray, shape (draw,)
        Not negative, not all zero; their scale does not matter.

    Returns
    -------
    float
        From 1 to the number of draws.
    """
    return float(np.sum(weights) ** 2 / np.sum(weights**2))


def effective_sample_size(draws: np.ndarray) -> float:
    """Effective number of independent draws for the mean of a quantity.

    Walkers of a stationary ensemble are independent at any one step, so the mean over walkers has the variance σ²/W, and
    ESS = E · W · S/τ, with τ from `series_time`.

    Parameters
    ----------
    draws : ndarray, shape (step, ensemble, walker)
        The quantity.

    Returns
    -------
    float
        ESS; NaN for a constant quantity.
    """
    return draws.size / series_time(draws)


def series_time(draws: np.ndarray) -> float:
    """Integrated autocorrelation time of a quantity, which gives the error of its mean.

    What counts is τ of the mean over each ensemble. A few ensembles determine it badly: from 300 steps with τ = 60, to a factor
    of four. The many walkers determine their own τ well, but not how they depend on one another. So the result is the walkers' τ,
    plus a share of the difference d by which the means' τ exceeds it. With the standard error s of the means' τ, this share is
    (1 − s²/d²)₊ (the non-negative garrote, L. Breiman 1995, doi 10.1080/00401706.1995.10484371). For chains shorter than some
    ten τ, the walkers alone decide: see `longest_time`.

    Parameters
    ----------
    draws : ndarray, shape (step, ensemble, walker)
        The quantity.

    Returns
    -------
    float
        τ in steps; NaN for a constant quantity.
    """
    alone, together, error = _times_alone_and_together(draws)
    beyond = together - alone
    return alone + (beyond - error**2 / beyond if beyond > error else 0.0)


def longest_time(draws: np.ndarray) -> float:
    """The longer of two autocorrelation times, the walkers' and their ensemble means', by which a chain's length is judged.

    Parameters
    ----------
    draws : ndarray, shape (step, ensemble, walker)
        The quantity.

    Returns
    -------
    float
        τ in steps; NaN for a constant quantity.
    """
    alone, together, _ = _times_alone_and_together(draws)
    return float(np.fmax(alone, together))


def _times_alone_and_together(draws: np.ndarray) -> tuple[float, float, float]:
    """τ of the walkers, τ of the means over each ensemble, and the standard error of that."""
    return autocorrelation_time(draws.reshape(len(draws), -1).T), *_time_and_error(draws.mean(axis=2).T)


def bulk_and_tail_size(draws: np.ndarray) -> tuple[float, float]:
    """Effective sample sizes of the rank-normalised draws, and the smaller of those of the 5 and 95 % quantiles.

    Parameters
    ----------
    draws : ndarray, shape (step, ensemble, walker)
        One parameter.

    Returns
    -------
    tuple of float
        Bulk and tail ESS (Vehtari et al. 2021, doi 10.1214/20-BA1221).
    """
    low, high = np.quantile(draws, [0.05, 0.95])
    tails = [effective_sample_size((draws <= q).astype(np.float64)) for q in (low, high)]
    return effective_sample_size(normal_scores(draws)), min(tails)


def r_hat(draws: np.ndarray) -> float:
    """Rank-normalised split R-hat over ensembles, the walkers of each pooled.

    Walkers of one ensemble are not independent chains; ensembles are.

    Parameters
    ----------
    draws : ndarray, shape (step, ensemble, walker)
        One parameter.

    Returns
    -------
    float
        R-hat (Vehtari et al. 2021), NaN with a single ensemble: there is nothing independent to compare.
    """
    steps, ensembles, walkers = draws.shape
    if ensembles < 2:
        return float("nan")
    # Step by step, so that the split into halves is a split in time.
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
    """Normal quantiles of the ranks of draws, Φ⁻¹((rank − 3/8)/(S + 1/4)).

    Parameters
    ----------
    draws : ndarray
        Any shape; all are ranked together.

    Returns
    -------
    ndarray
        In the same shape.
    """
    ranks = scipy.stats.rankdata(draws).reshape(draws.shape)
    return np.asarray(scipy.stats.norm.ppf((ranks - 0.375) / (draws.size + 0.25)))


def stuck_walkers(accepted: np.ndarray, log_density: np.ndarray) -> np.ndarray:
    """Walkers that hardly move, or that end far below where the others are.

    Parameters
    ----------
    accepted : ndarray of bool, shape (step, ensemble, walker)
        Whether each proposal was accepted, over the kept steps.
    log_density : ndarray, shape (step, ensemble, walker)
        Log density in sampling coordinates.

    Returns
    -------
    ndarray of bool, shape (ensemble, walker)
        True where the acceptance is below a fifth of the median, if the chains are long enough to tell, or the best log density
        of the last fifth of the steps, or the last twenty, is below anything the upper three quarters of all walkers visit.
    """
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
    """Diagnostics of one parameter.

    Parameters
    ----------
    r_hat, autocorrelation_time, bulk_size, tail_size : float
        R-hat over ensembles, τ in steps (`longest_time`), bulk and tail ESS.
    """

    r_hat: float
    autocorrelation_time: float
    bulk_size: float
    tail_size: float


def parameter_diagnostics(draws: np.ndarray) -> ParameterDiagnostics:
    """All diagnostics of one parameter.

    Parameters
    ----------
    draws : ndarray, shape (step, ensemble, walker)
        Its kept draws.

    Returns
    -------
    ParameterDiagnostics
        The figures.
    """
    bulk, tail = bulk_and_tail_size(draws)
    return ParameterDiagnostics(r_hat(draws), longest_time(draws), bulk, tail)


@dataclass(frozen=True)
class Verdict(ShownAsText):
    """Whether a run may be believed, and why not.

    Parameters
    ----------
    converged : bool
        True only if nothing in `failures` was found.
    failures : tuple of str
        What speaks against convergence, one sentence each.
    warnings : tuple of str
        What the reader must know besides convergence.
    wrong_model : tuple of str
        What speaks against the model; not judged before the run has converged.
    wrong_law : tuple of str
        What speaks against the law of the errors; likewise.
    parameters : dict of str to ParameterDiagnostics
        The figures behind it.
    acceptance : ndarray, shape (ensemble, walker)
        Acceptance rate over the kept steps.
    stuck : int
        Number of stuck walkers.
    failed_simulations : int
        Simulations within the prior's support that failed; they count as −inf.
    unexplained : float
        Fraction of the measurement's variance left unexplained by the best prediction; NaN where there is no measurement.
    kept_steps : int
        Steps kept after the start was dropped.
    needed_length : float
        Number of autocorrelation times that these steps must span: many for a chain, few for a large population.
    """

    converged: bool
    failures: tuple[str, ...]
    warnings: tuple[str, ...]
    parameters: dict[str, ParameterDiagnostics] = field(repr=False)
    acceptance: np.ndarray = field(repr=False)
    stuck: int
    failed_simulations: int
    unexplained: float
    kept_steps: int
    needed_length: float
    wrong_model: tuple[str, ...] = ()
    wrong_law: tuple[str, ...] = ()

    @property
    def doubt(self) -> str:
        """What is wrong with model or law, as a heading; empty where nothing speaks against them."""
        if self.wrong_model:
            return "The model is wrong for these data"
        return "The errors are not what their law says" if self.wrong_law else ""

    def __str__(self) -> str:
        head = "CONVERGED" if self.converged else "NOT CONVERGED: do not use these numbers"
        lines = [head, *(f"  - {f}" for f in self.failures), *(f"  ! {w}" for w in self.warnings)]
        if not self.converged:
            lines.append("  Priors, model and law of the errors are judged once the run has converged.")
        if self.doubt:
            lines += [self.doubt.upper(), *(f"  - {said}" for said in (*self.wrong_model, *self.wrong_law))]
        return "\n".join(lines)


def convergence_failures(
    parameters: dict[str, ParameterDiagnostics], kept_steps: int, ensembles: int, stuck: int, needed_length: float
) -> list[str]:
    """What speaks against convergence.

    Parameters
    ----------
    parameters : dict of str to ParameterDiagnostics
        The figures.
    kept_steps, ensembles, stuck : int
        Kept steps, independent ensembles, stuck walkers.
    needed_length : float
        Number of autocorrelation times that the kept steps of a converged run must span.

    Returns
    -------
    list of str
        A sentence for each failure; empty if converged.
    """
    failures: list[str] = []
    if ensembles < 2:
        failures.append("a single ensemble: there is no independent chain to compare with; run at least 2")
    else:
        name, worst = max(parameters.items(), key=lambda item: np.nan_to_num(item[1].r_hat, nan=np.inf))
        if not worst.r_hat < R_HAT_LIMIT:
            failures.append(f"R-hat of {name} is {worst.r_hat:.3f}, not below {R_HAT_LIMIT}: the ensembles disagree")
    name, slowest = max(parameters.items(), key=lambda item: np.nan_to_num(item[1].autocorrelation_time, nan=np.inf))
    if not kept_steps >= needed_length * slowest.autocorrelation_time:
        failures.append(
            f"{kept_steps} kept steps are {kept_steps / slowest.autocorrelation_time:.2g} autocorrelation times of {name} "
            f"(τ = {slowest.autocorrelation_time:.3g} steps), and {needed_length:g} or more are needed"
        )
    for kind in ("bulk", "tail"):
        sizes = {n: getattr(p, f"{kind}_size") for n, p in parameters.items()}
        name = min(sizes, key=lambda n: np.nan_to_num(sizes[n], nan=-np.inf))
        if not sizes[name] >= EFFECTIVE_SIZE_LIMIT:
            failures.append(
                f"{kind} effective sample size of {name} is {sizes[name]:.0f}, below {EFFECTIVE_SIZE_LIMIT}"
            )
    if stuck:
        failures.append(f"{stuck} stuck walker{'s' if stuck > 1 else ''}: they never joined the others")
    return failures


def disagreements(names: tuple[str, ...], draws: np.ndarray, beside: np.ndarray) -> list[str]:
    """Compare draws with those of an independent population: their means, and what lies beyond their 1 and 99 % quantiles.

    A few chains that all miss a mode, or never go far enough into a heavy tail, agree with one another.

    Parameters
    ----------
    names : tuple of str
        The parameters.
    draws, beside : ndarray, shape (step, ensemble, walker, parameter)
        Kept draws of both.

    Returns
    -------
    list of str
        A sentence for the quantity in which they differ most, if it is by more than five standard errors; else empty.
    """
    found = []
    for place, name in enumerate(names):
        ours, theirs = draws[..., place], beside[..., place]
        gap = _errors_apart(ours, theirs)
        found.append((gap, f"an independent population puts the mean of {name} {gap:.0f} standard errors elsewhere"))
        for probability, edge in zip(TAILS, np.quantile(ours, TAILS), strict=True):
            beyond = [(x <= edge if probability < 0.5 else x >= edge).astype(np.float64) for x in (ours, theirs)]
            found.append(
                (
                    _errors_apart(*beyond),
                    f"beyond the {probability:.0%} quantile of {name} lie {beyond[1].mean():.1%} of an independent population: the "
                    "chains do not go far enough into the tail, or the population too far",
                )
            )
    gap, sentence = max(found)
    return [sentence] if gap > ERRORS_APART else []


def _errors_apart(ours: np.ndarray, theirs: np.ndarray) -> float:
    """Difference of two means in combined standard errors; each error the larger of two, by sample size and by the ensembles."""
    variance = 0.0
    for x in (ours, theirs):
        of_ensembles = x.mean(axis=(0, 2))
        by_size = x.var() / max(effective_sample_size(x), 1.0) if np.ptp(x) else 0.0
        variance += max(by_size, of_ensembles.var(ddof=1) / len(of_ensembles) if len(of_ensembles) > 1 else 0.0)
    return float(abs(ours.mean() - theirs.mean()) / np.sqrt(variance)) if variance > 0.0 else 0.0
