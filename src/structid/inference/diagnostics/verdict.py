"""The verdict on a run: its convergence, and evidence against its results."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
import scipy
from jaxtyping import Float

from structid.core.notebook import ShownAsText
from structid.core.renamed import renamed_attribute
from structid.inference.convergence import ParameterDiagnostics, effective_sample_size, standard_error
from structid.inference.diagnostics.prior_warnings import PriorWarning
from structid.inference.prediction.best_prediction import BestPrediction
from structid.inference.sampling.smc.particle_mixing import DENSEST, shares_of_densest, still_moving

R_HAT_LIMIT = 1.01
"""Largest R-hat of a converged run (Vehtari et al. 2021)."""
EFFECTIVE_SIZE_LIMIT = 400
"""Smallest bulk and tail effective sample size of a converged run."""
TAILS = (0.01, 0.99)
"""Quantiles beyond which draws are compared with an independent population."""
SAYS_WHICH = {"bulk": "", "tail": "", "far tail": " (1 and 99 % quantiles)"}
"""Explanation added to an effective sample size."""
UNEVEN = 1e-6
"""Probability, over converged runs, of a variance between ensembles beside that expected from their autocorrelation times, below
which the ensembles disagree."""
ERRORS_APART = 5.0
"""Largest accepted difference of two estimates, in standard errors, when dozens of estimates are compared."""


@dataclass(frozen=True)
class Verdict(ShownAsText):
    """Assessment of a run: its convergence, and evidence against the model and the error model.

    Parameters
    ----------
    converged : bool
        True only if `failures` is empty.
    failures : tuple of str
        Evidence against convergence, one sentence each.
    warnings : tuple of str
        Warnings on other aspects than convergence, one sentence each.
    wrong_model : tuple of str
        Evidence against the model; not assessed before the run has converged.
    wrong_error_model : tuple of str
        Evidence against the error model; not assessed before the run has converged.
    against_priors : tuple of PriorWarning
        Warnings about priors that the data contradict, each with advice.
    parameters : dict of str to ParameterDiagnostics
        Convergence diagnostics of each parameter.
    acceptance : ndarray, shape (ensemble, walker)
        Acceptance rate over the kept steps.
    stuck : int
        Number of stuck walkers.
    failed_simulations : int
        Number of failed simulations within the prior's support; their log-likelihood is −inf.
    best : BestPrediction
        Fit of the best prediction to the measurement.
    kept_steps : int
        Number of steps kept after the discarded start.
    needed_length : float
        Number of autocorrelation times that the kept steps must span: many for a chain, few for a large population.
    smallest_basin : float
        Smallest basin of attraction, as a fraction of the prior, whose mode is found with a probability of 95 %; NaN without a
        search.
    """

    converged: bool
    failures: tuple[str, ...]
    warnings: tuple[str, ...]
    parameters: dict[str, ParameterDiagnostics] = field(repr=False)
    acceptance: Float[np.ndarray, "ensemble walker"] = field(repr=False)
    stuck: int
    failed_simulations: int
    best: BestPrediction
    kept_steps: int
    needed_length: float
    wrong_model: tuple[str, ...] = ()
    wrong_error_model: tuple[str, ...] = ()
    against_priors: tuple[PriorWarning, ...] = ()
    smallest_basin: float = float("nan")

    @property
    def unexplained(self) -> float:
        """Fraction of the measurement's variance left unexplained by the best prediction; NaN without a measurement."""
        return self.best.unexplained

    @property
    def another_size(self) -> bool:
        """Whether the peaks of the best prediction and the measurement differ so much that a unit is probably wrong."""
        return self.best.of_another_size

    wrong_law = renamed_attribute("wrong_law", "wrong_error_model")

    @property
    def doubt(self) -> str:
        """Heading for a wrong model or error model; empty where nothing contradicts them."""
        if self.wrong_model:
            return "The model is wrong for these data"
        return "The errors contradict the error model" if self.wrong_error_model else ""

    def __str__(self) -> str:
        head = "CONVERGED" if self.converged else "NOT CONVERGED: do not use these numbers"
        lines = [head, *(f"  - {f}" for f in self.failures), *(f"  ! {w}" for w in self.warnings)]
        if self.converged and np.isfinite(self.smallest_basin):
            lines.append(
                f"  Modes whose basin of attraction covers less than {self.smallest_basin:.2g} of the prior may be missing."
            )
        if not self.converged:
            lines.append("  Priors, model and error model are assessed once the run has converged.")
        if self.converged and not self.doubt and np.isfinite(self.unexplained):
            lines.append(
                "  There is no evidence against the model; its best prediction leaves "
                f"{100.0 * self.unexplained:.2g} % of the measured variance unexplained."
            )
        if self.doubt:
            lines += [
                self.doubt.upper(),
                *(f"  - {sentence}" for sentence in (*self.wrong_model, *self.wrong_error_model)),
            ]
        return "\n".join(lines)


def convergence_failures(
    parameters: dict[str, ParameterDiagnostics], kept_steps: int, ensembles: int, stuck: int, needed_length: float
) -> list[str]:
    """Evidence against convergence, one sentence each."""
    failures: list[str] = []
    if ensembles < 2:
        failures.append("a single ensemble has no independent chain for comparison; run at least 2 ensembles")
    else:
        name, worst = max(parameters.items(), key=lambda item: np.nan_to_num(item[1].r_hat, nan=np.inf))
        if not worst.r_hat < R_HAT_LIMIT:
            failures.append(f"R-hat of {name} is {worst.r_hat:.3f}, not below {R_HAT_LIMIT}: the ensembles disagree")
    name, slowest = max(parameters.items(), key=lambda item: np.nan_to_num(item[1].autocorrelation_time, nan=np.inf))
    if not kept_steps >= needed_length * slowest.autocorrelation_time:
        times = f"{kept_steps / slowest.autocorrelation_time:.2g}"
        failures.append(
            f"{kept_steps} kept steps span {times} autocorrelation time{'' if times == '1' else 's'} of {name} "
            f"(τ = {slowest.autocorrelation_time:.3g} steps); {needed_length:g} or more are needed"
        )
    for kind in ("bulk", "tail", "far tail"):
        sizes = {n: getattr(p, f"{kind.replace(' ', '_')}_size") for n, p in parameters.items()}
        name = min(sizes, key=lambda n: np.nan_to_num(sizes[n], nan=-np.inf))
        if not sizes[name] >= EFFECTIVE_SIZE_LIMIT:
            failures.append(
                f"{kind} effective sample size of {name} is {sizes[name]:.0f}, below {EFFECTIVE_SIZE_LIMIT}{SAYS_WHICH[kind]}"
            )
    if stuck:
        failures.append(f"{stuck} stuck walker{'s' if stuck > 1 else ''}: they never joined the others")
    return failures


def unrest(
    names: tuple[str, ...],
    draws: Float[np.ndarray, "step ensemble walker parameter"],
    log_density: Float[np.ndarray, "step ensemble walker"],
) -> list[str]:
    """Sentence about particles from the prior that have not reached equilibrium."""
    moving = still_moving(draws, log_density)
    if not moving:
        return []
    index, errors = max(moving.items(), key=lambda item: abs(item[1]))
    shares = (f"the share of the densest {1.0 - quantile:.0%} of the draws" for quantile in DENSEST)
    quantity = (*names, "the log density", *shares)[index]
    return [
        f"the particles are not in equilibrium: {quantity} {'rises' if errors > 0 else 'falls'} by {abs(errors):.0f} standard "
        "errors while they move; regions they have not reached are missing from the draws and the evidence"
    ]


def uneven_shares(log_density: Float[np.ndarray, "step ensemble walker"]) -> list[str]:
    """Sentence about ensembles that hold different shares of the densest draws, as beside a narrow spike."""
    for quantile, densest in zip(DENSEST, shares_of_densest(log_density), strict=True):
        each = densest.mean(axis=(0, 2))
        by_size = densest.var() / max(effective_sample_size(densest), 1.0) if np.ptp(densest) else 0.0
        squares = np.sum((each - each.mean()) ** 2) / (len(each) * by_size) if by_size > 0.0 else 0.0
        if len(each) > 1 and scipy.stats.chi2.sf(squares, len(each) - 1) < UNEVEN:
            return [
                f"the ensembles hold between {each.min():.2%} and {each.max():.2%} of their draws where the densest "
                f"{1.0 - quantile:.0%} of all draws lie: some have not found a narrow region of high density, or its size"
            ]
    return []


def disagreements(
    names: tuple[str, ...],
    draws: Float[np.ndarray, "step ensemble walker parameter"],
    beside: Float[np.ndarray, "_ _ _ parameter"],
) -> list[str]:
    """Compare draws with an independent population: means, and masses beyond the 1 and 99 % quantiles.

    A few chains that all miss a mode, or part of a heavy tail, agree with one another.
    """
    sentences = []
    for index, name in enumerate(names):
        own_draws, other_draws = draws[..., index], beside[..., index]
        gap = _errors_apart(own_draws, other_draws)
        sentences.append((gap, f"the mean of {name} in an independent population differs by {gap:.0f} standard errors"))
        for probability, edge in zip(TAILS, np.quantile(own_draws, TAILS), strict=True):
            beyond = [
                (x <= edge if probability < 0.5 else x >= edge).astype(np.float64) for x in (own_draws, other_draws)
            ]
            sentences.append(
                (
                    _errors_apart(*beyond),
                    f"{beyond[1].mean():.1%} of an independent population lie beyond the {probability:.0%} quantile of {name}: the "
                    "chains cover too little of the tail, or the population too much",
                )
            )
    gap, sentence = max(sentences)
    return [sentence] if gap > ERRORS_APART else []


def _errors_apart(first: np.ndarray, second: np.ndarray) -> float:
    """Difference of two means in combined standard errors."""
    error = math.hypot(standard_error(first), standard_error(second))
    return float(abs(first.mean() - second.mean()) / error) if error > 0.0 else 0.0
