"""Power of the certificate: shares of wrong and of correct densities that it accepts, in four and ten dimensions.

Run with ``python benchmarks/power.py [--quick]``.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable

import common
import numpy as np
import scipy
from attacks import boxed

import structid as si
from structid.certification.certificate import issue_certificate
from structid.certification.fresh_draws import FreshDraws, StoredRuns

NAME = "power"
DIMENSIONS = (4, 10)
ALONE, TAUGHT = 200, 40
"""Replications with fresh draws only, and with `si.certify`, which also learns."""
PLAIN, TEMPERED, EXPONENT = 20, 10, 0.5
POPULATION = np.random.default_rng(0).standard_normal((500, max(DIMENSIONS)))
CORRELATED = 0.3
HEADS = [
    "true density relative to q = N(0, I)",
    "limit",
    *(f"certified by 30 fresh draws, d = {d}" for d in DIMENSIONS),
    *(f"certified by `si.certify`, d = {d}" for d in DIMENSIONS),
]
LogRatio = Callable[[np.ndarray], np.ndarray]
"""Function that returns log π/q at points, up to a constant."""


# --- true densities -------------------------------------------------------------------------------------------------


def ripples(spread: float) -> LogRatio:
    """Weights that vary from point to point, without a preferred direction and without changing the moments of q."""
    return lambda theta: np.sqrt(2.0) * spread * np.sin(1e3 * theta @ np.arange(1.0, theta.shape[1] + 1.0))


def other_sd(factor: float) -> LogRatio:
    return lambda theta: -0.5 * theta[:, 0] ** 2 * (factor**-2 - 1.0)


def correlated(theta: np.ndarray) -> np.ndarray:
    x, y = theta[:, 0], theta[:, 1]
    return -0.5 * (x**2 - 2.0 * CORRELATED * x * y + y**2) / (1.0 - CORRELATED**2) + 0.5 * (x**2 + y**2)


def heavier_tail(share: float, too_light: float) -> LogRatio:
    """True density that is `too_light` times q in the upper tail, which has the probability `share` under q."""
    edge = scipy.stats.norm.isf(share)
    return lambda theta: np.where(theta[:, 0] > edge, np.log(too_light), 0.0)


CASES: dict[str, tuple[str, LogRatio]] = {
    "equal to q, weights of spread 10⁻⁶": ("100 %", ripples(1e-6)),
    "equal to q": ("95 % or more", ripples(0.0)),
    "equal to q, weights of spread 0.03": ("95 % or more", ripples(0.03)),
    "all sds 2 % smaller": ("within the limits", lambda theta: -0.5 * (theta**2).sum(axis=1) * (0.98**-2 - 1.0)),
    "sd 0.8 in one parameter": ("1 % or less", other_sd(0.8)),
    "sd 1.2 in one parameter": ("1 % or less", other_sd(1.2)),
    "one mean shifted by 0.2 sd": ("1 % or less", lambda theta: 0.2 * theta[:, 0]),
    "a correlation of 0.3": ("1 % or less", correlated),
    "5 % tail, ten times as heavy": ("10 % or less", heavier_tail(0.05, 10.0)),
}


# --- both methods ---------------------------------------------------------------------------------------------------


def by_draws_alone(log_ratio: LogRatio, dimension: int, seed: int) -> bool:
    """Certificate by fresh draws, two thirds of them from q and one third from q^½."""
    rng = np.random.default_rng(seed)
    theta = rng.standard_normal((PLAIN + TEMPERED, dimension))
    theta[PLAIN:] /= np.sqrt(EXPONENT)
    squares = (theta**2).sum(axis=1)
    log_drawn = -0.5 * squares
    mixed = PLAIN + TEMPERED * EXPONENT ** (dimension / 2) * np.exp(0.5 * (1.0 - EXPONENT) * squares)
    of_law = POPULATION[:, :dimension]
    fresh = FreshDraws(theta, theta, log_drawn + log_ratio(theta), log_drawn, 1.0 / mixed, of_law, 0.0)
    names = tuple(f"x{i}" for i in range(dimension))
    return issue_certificate(fresh, StoredRuns(), names, len(theta)).certified


def taught(log_ratio: LogRatio, dimension: int, seed: int) -> bool:
    """Certificate by `si.certify` with its defaults, including the search for modes and learning from the runs."""

    def log_density(theta: np.ndarray) -> np.ndarray:
        return np.asarray(scipy.stats.norm.logpdf(theta).sum(axis=1))

    true = boxed(lambda theta: log_density(theta) + log_ratio(theta), dimension)
    draws = np.random.default_rng(seed).standard_normal((4000, dimension))
    return si.certify(true, draws, log_density, seed=seed).certified


def share(certified: list[bool]) -> str:
    return f"{sum(certified)} of {len(certified)}"


def rows(quick: bool) -> list[list[str]]:
    found = []
    alone, beside = (20, 1) if quick else (ALONE, TAUGHT)
    for case, (limit, log_ratio) in list(CASES.items())[:: 4 if quick else 1]:
        began = time.perf_counter()
        of_draws = [share([by_draws_alone(log_ratio, d, seed) for seed in range(alone)]) for d in DIMENSIONS]
        of_both = [share([taught(log_ratio, d, seed) for seed in range(beside)]) for d in DIMENSIONS]
        found.append([case, limit, *of_draws, *of_both])
        print(" | ".join(found[-1]), f"({time.perf_counter() - began:.0f} s)", flush=True)
    return found


def main() -> None:
    quick = common.is_quick(__doc__.splitlines()[0])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = rows(quick)
    text = f"""# Power of the certificate

`benchmarks/power.py`. {common.machine()}.

The draws come from q, a standard normal density; the model has another density. The first certificates use only the weights of 30
fresh draws, as in a calibration: {PLAIN} from q, {TEMPERED} from q^½. The others use `si.certify` with 4000 draws of q and its
density. It searches for modes and, if the weights are inconclusive, learns the true density from its runs.

{common.markdown_table(HEADS, found)}
"""
    common.record_result(NAME, quick=quick, machine=common.machine(), rows=found)
    common.write_page(quick, NAME, text)
    print(text)


if __name__ == "__main__":
    main()
