"""The question: how often does the certificate stop what is wrong, and let pass what is right, in four and in ten dimensions.

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
"""Replications of the fresh draws alone, and of `si.certify`, which learns."""
PLAIN, TEMPERED, EXPONENT = 20, 10, 0.5
POPULATION = np.random.default_rng(0).standard_normal((500, max(DIMENSIONS)))
CORRELATED = 0.3
HEADS = [
    "q = N(0, I), and the true density",
    "limit",
    *(f"certified by 30 fresh draws alone, d = {d}" for d in DIMENSIONS),
    *(f"by `si.certify`, d = {d}" for d in DIMENSIONS),
]
LogRatio = Callable[[np.ndarray], np.ndarray]
"""log π/q at points, up to a constant."""


# --- true laws ------------------------------------------------------------------------------------------------------


def ripples(spread: float) -> LogRatio:
    """Weights that vary from point to point, in no direction more than in another, and without any of q's moments moved."""
    return lambda theta: np.sqrt(2.0) * spread * np.sin(1e3 * theta @ np.arange(1.0, theta.shape[1] + 1.0))


def other_sd(factor: float) -> LogRatio:
    return lambda theta: -0.5 * theta[:, 0] ** 2 * (factor**-2 - 1.0)


def correlated(theta: np.ndarray) -> np.ndarray:
    x, y = theta[:, 0], theta[:, 1]
    return -0.5 * (x**2 - 2.0 * CORRELATED * x * y + y**2) / (1.0 - CORRELATED**2) + 0.5 * (x**2 + y**2)


def heavier_tail(share: float, too_light: float) -> LogRatio:
    """The true law has so many times more density in the upper tail of q, which has a share of its probability."""
    edge = scipy.stats.norm.isf(share)
    return lambda theta: np.where(theta[:, 0] > edge, np.log(too_light), 0.0)


CASES: dict[str, tuple[str, LogRatio]] = {
    "the same, to weights of spread 10⁻⁶": ("100 %", ripples(1e-6)),
    "the same": ("95 % or more", ripples(0.0)),
    "the same, to weights of spread 0.03": ("95 % or more", ripples(0.03)),
    "sd 0.8 in one parameter": ("1 % or less", other_sd(0.8)),
    "sd 1.2 in one parameter": ("1 % or less", other_sd(1.2)),
    "one mean 0.2 sd away": ("1 % or less", lambda theta: 0.2 * theta[:, 0]),
    "a correlation of 0.3": ("1 % or less", correlated),
    "a tail of 5 % that is ten times as heavy": ("10 % or less", heavier_tail(0.05, 10.0)),
}


# --- both ways ------------------------------------------------------------------------------------------------------


def by_draws_alone(log_ratio: LogRatio, dimension: int, seed: int) -> bool:
    """Two thirds of the fresh draws from q, one third from q^½."""
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
    """`si.certify` with its defaults: it searches for modes, and what the draws do not decide it learns."""

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

The draws come from q, a standard normal density; the model has another one. First by the weights of 30 fresh draws alone, as in a
calibration: {PLAIN} of q, {TEMPERED} of q^½. Then by `si.certify` with 4000 draws of q and its density, which searches for modes
and, where the weights do not decide, learns from its runs what the true density is.

{common.markdown_table(HEADS, found)}
"""
    common.record_result(NAME, quick=quick, machine=common.machine(), rows=found)
    common.write_page(quick, NAME, text)
    print(text)


if __name__ == "__main__":
    main()
