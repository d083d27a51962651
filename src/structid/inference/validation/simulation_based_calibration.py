"""Simulation-based calibration: whether a posterior has its nominal coverage where the truth is known.

Parameters are drawn from the prior, a measurement is simulated for each draw, and each replica is calibrated. If prior, model,
likelihood and sampler are consistent, the rank of the true parameter among the posterior draws is uniform (S. Talts et al. 2018,
arXiv 1804.06788), and a 90 % interval contains it in nine replicas of ten.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import scipy
from jaxtyping import Float, Int

from structid.core.errors import ConvergenceError, InputError
from structid.core.notebook import ShownAsText
from structid.core.progress import Progress
from structid.core.renamed import renamed_argument
from structid.core.streams import Purpose, stream
from structid.core.units import label
from structid.core.validation import check_arguments
from structid.inference.error_models.base import Discrepancy
from structid.inference.likelihood.posterior import Posterior
from structid.inference.sampling.base import Block
from structid.inference.sampling.smc.smc import SMC
from structid.inference.validation.replicated_posterior import ReplicatedPosterior
from structid.models.base import Model

if TYPE_CHECKING:
    from matplotlib.figure import Figure

REPLICA_SAMPLER = SMC(particles=100, ensembles=1, steps=40, effective_share=0.5, correlation=0.3)
"""Sampler of each replica; the replicas are tempered together."""
TELLING = 2.5
"""Number of standard errors above which posteriors are called shifted, too wide or too narrow."""
LEVEL = 0.01
"""Probability that correct ranks are rejected."""
LOG_LIKELIHOOD = "log-likelihood"
"""Name of the last ranked quantity."""
ENOUGH_REPLICAS = 100
"""Number of replicas below which only gross mistakes are revealed."""
FEWEST_REPLICAS = 20
"""Minimum number of replicas."""


@dataclass(frozen=True, eq=False)
class Ranks(ShownAsText):
    """Outcome of a simulation-based calibration.

    Parameters
    ----------
    names, units : tuple of str
        Quantities and their display units: the parameters, and last the log-likelihood. Only the log-likelihood reveals
        a likelihood that ignores the data (M. Modrák et al. 2023, doi 10.1214/23-BA1404).
    truth : ndarray, shape (replica, quantity)
        True values of the quantities, drawn from the prior, in SI.
    draws : ndarray, shape (replica, draw, quantity)
        Draws of each replica's posterior, in SI.
    ranks : ndarray, shape (replica, quantity)
        Number of each replica's last particles that lie below the truth.
    particles : int
        Number of last particles; ranks range from 0 to this number.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    truth: Float[np.ndarray, "replica quantity"] = field(repr=False)
    draws: Float[np.ndarray, "replica draw quantity"] = field(repr=False)
    ranks: Int[np.ndarray, "replica quantity"] = field(repr=False)
    particles: int

    @cached_property
    def p_values(self) -> np.ndarray:
        """Probability that a correct posterior deviates at least this much from uniform ranks, shape (quantity,).

        Four times the smallest of four p-values: of the ranks' histogram by χ², of their distribution function by Kolmogorov and
        Smirnov, and of the numbers of 50 and 90 % intervals that contain the truth, which are binomial.
        """
        count = len(self.truth)
        tests = [scipy.stats.chisquare(self.histogram(self.bins), axis=1).pvalue]
        tests.append([scipy.stats.kstest(column, "uniform").pvalue for column in self._places.T])
        for probability in (0.5, 0.9):
            held = np.rint(self.coverage(probability) * count).astype(int)
            tests.append([scipy.stats.binomtest(int(k), count, probability).pvalue for k in held])
        return np.asarray(np.minimum(1.0, len(tests) * np.min(tests, axis=0)))

    @cached_property
    def _places(self) -> np.ndarray:
        """Ranks scaled to [0, 1], with a random shift of less than one rank, (replica, quantity)."""
        rng = stream(0, Purpose.RANK_JITTER)
        return np.asarray((self.ranks + rng.random(self.ranks.shape)) / (self.particles + 1))

    @property
    def bins(self) -> int:
        """Number of histogram bins: one per ten replicas, but at least 2 and at most 20."""
        return int(np.clip(len(self.truth) // 10, 2, 20))

    def histogram(self, bins: int) -> Int[np.ndarray, "quantity bin"]:
        """Count the ranks.

        Parameters
        ----------
        bins : int
            Number of bins.

        Returns
        -------
        ndarray, shape (quantity, bin)
            Replicas in each bin. A random shift of the ranks gives all bins equal probability, even if they contain
            unequal numbers of ranks.
        """
        return np.stack([np.histogram(column, bins, (0.0, 1.0))[0] for column in self._places.T])

    @property
    def uniform(self) -> bool:
        """Whether the ranks and intervals of all quantities pass a test at a joint level of 1 %."""
        return bool(self.p_values.min() > LEVEL / len(self.names))

    def coverage(self, probability: float) -> Float[np.ndarray, " quantity"]:
        """Fraction of the replicas whose central interval contains the truth.

        Parameters
        ----------
        probability : float
            Probability of the interval.

        Returns
        -------
        ndarray, shape (quantity,)
            For a correct posterior, `probability` up to the error of a finite number of replicas.
        """
        tail = 0.5 * (1.0 - probability)
        low, high = np.quantile(self.draws, [tail, 1.0 - tail], axis=1)
        return np.asarray(((self.truth >= low) & (self.truth <= high)).mean(axis=0))

    @property
    def verdict(self) -> str:
        """The result in a sentence."""
        count, worst = len(self.truth), int(np.argmin(self.p_values))
        p, name = self.p_values[worst], self.names[worst]
        if self.uniform:
            sentence = (
                f"Calibrated: the ranks of the truth are uniform in {count} replicas, and intervals contain it with the stated "
                f"probability (smallest p = {p:.2g}, for {name})."
            )
            if count < ENOUGH_REPLICAS:
                unseen = 2.0 * np.sqrt(0.9 * 0.1 / count)
                sentence += (
                    f" So few replicas reveal only gross errors: the coverage is uncertain by ±{unseen:.0%} "
                    "(±4% with 200 replicas)."
                )
            return sentence
        of_parameters = [p for quantity, p in zip(self.names, self.p_values, strict=True) if quantity != LOG_LIKELIHOOD]
        if of_parameters and min(of_parameters) <= LEVEL / len(self.names):
            worst = int(np.argmin(of_parameters))  # a parameter is more informative
            p, name = self.p_values[worst], self.names[worst]
        elif name == LOG_LIKELIHOOD:
            return (
                f"NOT CALIBRATED: the log-likelihood of the truth has wrong ranks among the draws' log-likelihoods in {count} "
                f"replicas (p = {p:.1g}): the posteriors do not use the data as their likelihood requires."
            )
        half = self.coverage(0.5)[worst]
        return (
            f"NOT CALIBRATED: the posteriors of {name} are {_how_wrong(self._places[:, worst])} in {count} replicas "
            f"(p = {p:.1g}). The 50 % intervals contain "
            f"the truth in {half:.0%} of them, the 90 % intervals in {self.coverage(0.9)[worst]:.0%}."
        )

    def __str__(self) -> str:
        heads = [label(n, u) for n, u in zip(self.names, self.units, strict=True)]
        width = max(len(h) for h in heads)
        lines = [self.verdict, "".ljust(width) + "  50 % holds  90 % holds   p of the ranks"]
        for head, half, most, p in zip(heads, self.coverage(0.5), self.coverage(0.9), self.p_values, strict=True):
            lines.append(f"{head.ljust(width)}{half:12.0%}{most:12.0%}{p:17.3g}")
        return "\n".join(lines)

    def plot(self, save: str | os.PathLike[str] | None = None) -> Figure:
        """Draw the rank histograms and the distribution functions of the ranks.

        Parameters
        ----------
        save : path-like, optional
            File name without extension.

        Returns
        -------
        Figure
            Two panels per parameter.
        """
        from structid.figures.calibration import ranks

        held = self.coverage(0.5), self.coverage(0.9)
        return ranks(self.names, self.histogram(self.bins), len(self.truth), *held, self._places, save=save)


def _how_wrong(places: np.ndarray) -> str:
    """Describe how the ranks of the truth deviate from uniform.

    Their mean should be 1/2 ± √(1/12n), their variance 1/12 ± √(1/180n).
    """
    shift = (np.mean(places) - 0.5) * np.sqrt(12.0 * len(places))
    spread = (np.mean((places - 0.5) ** 2) - 1.0 / 12.0) * np.sqrt(180.0 * len(places))
    if max(abs(shift), abs(spread)) < TELLING:
        return "of the wrong shape"
    if abs(shift) > abs(spread):
        return "shifted to values that are too small" if shift > 0.0 else "shifted to values that are too large"
    return "too narrow" if spread > 0.0 else "too wide"


@renamed_argument(explorer="sampler")
@check_arguments
def sbc(
    posterior: Posterior,
    replicas: int = 200,
    *,
    seed: int = 0,
    sampler: SMC = REPLICA_SAMPLER,
    simulator: Model | None = None,
    noise: Discrepancy | None = None,
    progress: Progress | None = None,
) -> Ranks:
    """Simulate measurements with parameters drawn from the prior, and calibrate to each measurement.

    The replicas are sampled together by tempered SMC, one population each. If the prior of an error variance depends on
    the measurement, all replicas use the prior that the posterior's own measurement gives.

    Parameters
    ----------
    posterior : Posterior
        Posterior with any model. Its measurements affect only the default priors of error variances. An expensive
        solver would need a million runs: instead, fit a surrogate to it over the whole prior, and give the solver as
        `simulator`.
    replicas : int
        Number of replicas.
    seed : int
        Seed.
    sampler : SMC
        Sampler of each replica.
    simulator : Model, optional
        Model that simulates the measurements; by default the posterior's own model. Give the original model of a surrogate to
        test the surrogate's error, too.
    noise : Discrepancy, optional
        Error model of the simulated measurements; by default the posterior's own. Its parameters must be known.
    progress : callable, optional
        Called with the percentage done and 100.

    Returns
    -------
    Ranks
        Ranks, coverage and verdict, which ``print`` shows.

    Raises
    ------
    InputError
        If there are too few replicas.
    ConvergenceError
        If most simulations at draws of the prior fail.

    Examples
    --------
    >>> import structid as si
    >>> ranks = si.sbc(posterior, replicas=200, seed=1)  # doctest: +SKIP
    >>> print(ranks.verdict)  # doctest: +SKIP
    """
    if replicas < FEWEST_REPLICAS:
        raise InputError("sbc(replicas)", f"{replicas}", f"{FEWEST_REPLICAS} or more, ideally 200")
    truth, values = _simulated(posterior, replicas, seed, simulator, noise)
    target = ReplicatedPosterior(posterior, values)
    blocks: list[Block] = []
    drawn = replace(sampler, ensembles=replicas, scouts=0).run(
        target, seed, None, [], lambda _index, block: blocks.append(block), progress
    )
    theta = posterior.bijection(drawn.phi.reshape(-1, posterior.dimension))[0].reshape(drawn.phi.shape)
    likelihood = np.concatenate([block["likelihood"] for block in blocks])[-len(theta) :]
    of_truth = target.evaluate_parts(posterior.bijection.inverse(truth))[1]
    drawn_of_all = np.concatenate([theta, likelihood[..., None]], axis=-1)
    truth_of_all = np.column_stack([truth, of_truth])
    ranks = (drawn_of_all[-1] < truth_of_all[:, None, :]).sum(axis=1)
    # Five of the steps, since particles of neighbouring steps are nearly the same.
    some = (
        drawn_of_all[:: max(1, sampler.steps // 5)]
        .transpose(1, 0, 2, 3)
        .reshape(replicas, -1, len(posterior.names) + 1)
    )
    names, units = (*posterior.names, LOG_LIKELIHOOD), (*posterior.units.values(), "")
    return Ranks(names, units, truth_of_all, some, ranks, sampler.particles)


def _simulated(
    posterior: Posterior, replicas: int, seed: int, simulator: Model | None, noise: Discrepancy | None
) -> tuple[np.ndarray, list[np.ndarray]]:
    """True parameters and simulated observations, (replica, time, channel)."""
    truth, values = simulated_truths(posterior if simulator is None else posterior.on(simulator), replicas, seed)
    rng = stream(seed, Purpose.REPLICA_NOISE)
    for index, bound in enumerate(posterior.likelihood.of):
        unknown = posterior.unknowns(truth, index)
        values[index] = values[index] + bound.draw_errors(rng, values[index], unknown, bound.dt, of=noise)
    return truth, values


def simulated_truths(source: Posterior, replicas: int, seed: int) -> tuple[np.ndarray, list[np.ndarray]]:
    """Draws of the prior (replica, parameter), and the readings of every observation without errors (replica, time, channel)."""
    rng = stream(seed, Purpose.REPLICA_TRUTH)
    truth, values = np.empty((0, source.dimension)), [np.empty(0)] * len(source.observations)
    for attempt in range(10):
        draws = source.space.from_uniform(rng.random((replicas, source.dimension)))
        clean = [source.predict(draws, i) for i in range(len(source.observations))]
        good = np.stack([np.isfinite(c).all(axis=(1, 2)) for c in clean]).all(axis=0)
        kept = [c[good] for c in clean]
        values = kept if attempt == 0 else [np.concatenate([v, c]) for v, c in zip(values, kept, strict=True)]
        truth = np.concatenate([truth, draws[good]])
        if len(truth) >= replicas:
            break
    else:
        raise ConvergenceError(f"Only {len(truth)} of {10 * replicas} simulations at draws of the prior succeed.")
    return truth[:replicas], [v[:replicas] for v in values]
