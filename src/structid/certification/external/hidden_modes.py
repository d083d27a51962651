"""Search for modes that external draws have missed, by model runs.

Draws contain no information about regions without draws. A Kriging surrogate of the log density, fitted to all known runs,
predicts where it could be high. The surrogate is uncertain far from the runs. If all runs are at draws, they lie close together,
and their extrapolated trend makes the surrogate overconfident everywhere. Without other runs, the search therefore begins at
draws of the prior. The model is then run at the points most likely to have a relevant density. Parameters with the same prior may
be exchangeable: the first runs exchange two of them in the best draw. If a run finds a relevant density, no certificate is
issued. A mode may still be missed.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np
import scipy

from structid.certification.external.drawn_density import DrawnDensity
from structid.certification.external.kriged_density import CORRELATIONS, Chart, KrigedDensity, standardised_by
from structid.certification.known_points import Points, joined
from structid.certification.limits import Limits

SCOUTS = 4000
"""Number of prior draws from which the points for runs are chosen."""
AT_ONCE = 3
"""Number of runs in each round; it is small, since each round informs the choice of the next runs."""
APART = 0.3
"""Smallest distance between two runs of a round, in standard deviations of the prior."""
NEAR = 3.0
"""Multiple of `Limits.reach` below the best run within which a run doubles the number of search runs."""
ALIKE = 0.05
"""Largest distance of the distribution functions of two parameters with the same prior, over the scouts."""
HOPELESS = -10.0
"""Predicted log density minus a relevant one, in Kriging standard deviations, below which the search ends."""


def searched(
    drawn: DrawnDensity,
    at_draws: Points,
    known: Points,
    middle: float,
    count: int,
    run: Callable[[np.ndarray], np.ndarray],
    limits: Limits,
    rng: np.random.Generator,
) -> Points:
    """Run the model where q may have missed a mode."""
    scouts = drawn.posterior.initial(SCOUTS, rng)
    scouts = scouts[np.isfinite(scouts).all(axis=1)]
    chart = standardised_by(scouts)
    z = chart(scouts)[0]
    theta, jacobian = drawn.bijection(scouts)
    of_draws = drawn.log_density(theta) + middle
    # Regions that the draws do not visit; fresh draws of a wider density cover the tails of the draws.
    best = max(at_draws[1].max(), known[1].max(initial=-np.inf))
    free = (of_draws < best - limits.reach) & ~drawn.covers(theta)
    exchanged = _exchanged(drawn, at_draws, scouts)[:count]
    new_runs: Points = exchanged, run(exchanged) if len(exchanged) else np.empty(0)
    most = count
    while len(new_runs[0]) < most and free.any():
        others = joined(known, new_runs)
        points, log_true = joined(at_draws, others)
        matters = np.maximum(log_true.max() - limits.reach, of_draws + limits.excess)
        if np.count_nonzero(~drawn.covers(others[0])) < AT_ONCE:
            chance = rng.random(len(z))  # arbitrary draws of the prior
        else:
            mean, deviation = _kriged(drawn, chart, (points, log_true)).at(scouts)
            chance = (mean - jacobian - matters) / np.maximum(deviation, 1e-9)
        places = _apart(np.where(free, chance, -np.inf), z, min(AT_ONCE, most - len(new_runs[0])))
        if not len(places):
            break
        result = run(theta[places])
        new_runs = joined(new_runs, (theta[places], result))
        free[places] = False
        if (result >= matters[places]).any():
            break
        if (result >= best - NEAR * limits.reach).any():
            most = 2 * count
    return new_runs


def _exchanged(drawn: DrawnDensity, at_draws: Points, scouts: np.ndarray) -> np.ndarray:
    """The best draw with two parameters of the same prior exchanged, where this leaves the draws; the farthest first."""
    best, sd = at_draws[0][np.argmax(at_draws[1])], drawn.flat.std(axis=0)
    found = []
    for i, j in itertools.combinations(range(len(best)), 2):
        if scipy.stats.ks_2samp(scouts[:, i], scouts[:, j]).statistic < ALIKE:
            point = best.copy()
            point[[i, j]] = best[[j, i]]
            found.append((abs(best[i] - best[j]) / np.hypot(sd[i], sd[j]), point))
    points = np.array([point for _, point in sorted(found, key=lambda one: -one[0])]).reshape(-1, len(best))
    return points[~drawn.covers(points)] if len(points) else points


def _kriged(drawn: DrawnDensity, chart: Chart, known: Points) -> KrigedDensity:
    """Log π with respect to φ."""
    theta, log_true = known
    phi = drawn.bijection.inverse(theta)
    values = log_true + drawn.bijection(phi)[1]
    ran = np.isfinite(values)
    forms = [(chart, correlation) for correlation in CORRELATIONS]
    return KrigedDensity.best(forms, phi[ran], values[ran], np.ones(int(ran.sum())))


def _apart(chance: np.ndarray, z: np.ndarray, count: int) -> np.ndarray:
    """Return the most promising points, with a minimum distance between them."""
    places: list[int] = []
    for index in np.argsort(-chance):
        if len(places) == count or chance[index] < HOPELESS:
            break
        if all(np.linalg.norm(z[index] - z[other]) > APART for other in places):
            places.append(int(index))
    return np.array(places, dtype=int)
