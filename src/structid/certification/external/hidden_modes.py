"""A search for what draws have missed: runs where a mode could be that the drawn law does not have.

Draws say nothing of where they are not. A Kriging of the log density, at all runs that are known, says where it could be high.
It is unsure where nobody has been; but runs at draws alone, all close to one another, make it sure of everything: their trend goes
on for ever. So where there are no others, the search begins at any draws of the prior that lie beyond. Then the model is run at
those that are most likely to have a density that matters. If one of them has, it outranks the draws, and no certificate is given.
What is not found may still be there.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from structid.certification.external.drawn_density import DrawnLaw
from structid.certification.external.kriged_density import CORRELATIONS, Chart, KrigedDensity, standardised_by
from structid.certification.known_points import Points, joined
from structid.certification.limits import Limits

SCOUTS = 4000
"""Draws of the prior among which a run is chosen."""
AT_ONCE = 3
"""Runs of a round: each tells much of where the next one should be."""
APART = 0.3
"""Smallest distance between two of them, in standard deviations of the prior."""
NEAR = 3.0
"""Times `Limits.reach` below the best run within which a run has come near to something: the search goes on there."""
HOPELESS = -10.0
"""Standard deviations of the Kriging below what would matter at which the search ends."""


def searched(
    law: DrawnLaw,
    at_draws: Points,
    known: Points,
    middle: float,
    count: int,
    run: Callable[[np.ndarray], np.ndarray],
    limits: Limits,
    rng: np.random.Generator,
) -> Points:
    """Run the model where a mode could be that q does not have."""
    scouts = law.posterior.initial(SCOUTS, rng)
    scouts = scouts[np.isfinite(scouts).all(axis=1)]
    chart = standardised_by(scouts)
    z = chart(scouts)[0]
    theta, jacobian = law.bijection(scouts)
    of_draws = law.log_density(theta) + middle
    # What the draws do not visit; in their tails, fresh draws of a wider law see for themselves.
    best = max(at_draws[1].max(), known[1].max(initial=-np.inf))
    free = (of_draws < best - limits.reach) & ~law.covers(theta)
    made: Points = np.empty((0, law.posterior.dimension)), np.empty(0)
    most = count
    while len(made[0]) < most and free.any():
        others = joined(known, made)
        points, log_true = joined(at_draws, others)
        matters = np.maximum(log_true.max() - limits.reach, of_draws + limits.excess)
        if np.count_nonzero(~law.covers(others[0])) < AT_ONCE:
            chance = rng.random(len(z))  # any draws of the prior
        else:
            mean, deviation = _kriged(law, chart, (points, log_true)).at(scouts)
            chance = (mean - jacobian - matters) / np.maximum(deviation, 1e-9)
        places = _apart(np.where(free, chance, -np.inf), z, min(AT_ONCE, most - len(made[0])))
        if not len(places):
            break
        found = run(theta[places])
        made = joined(made, (theta[places], found))
        free[places] = False
        if (found >= matters[places]).any():
            break
        if (found >= best - NEAR * limits.reach).any():
            most = 2 * count
    return made


def _kriged(law: DrawnLaw, chart: Chart, known: Points) -> KrigedDensity:
    """Log π with respect to φ."""
    theta, log_true = known
    phi = law.bijection.inverse(theta)
    values = log_true + law.bijection(phi)[1]
    ran = np.isfinite(values)
    forms = [(chart, correlation) for correlation in CORRELATIONS]
    return KrigedDensity.best(forms, phi[ran], values[ran], np.ones(int(ran.sum())))


def _apart(chance: np.ndarray, z: np.ndarray, count: int) -> np.ndarray:
    """The most promising points, no two of them close to one another."""
    places: list[int] = []
    for place in np.argsort(-chance):
        if len(places) == count or chance[place] < HOPELESS:
            break
        if all(np.linalg.norm(z[place] - z[other]) > APART for other in places):
            places.append(int(place))
    return np.array(places, dtype=int)
