"""Fit of one hysteretic law to a cyclic test under one error model: the best parameters, and the evidence."""

from __future__ import annotations

import copy
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import scipy.special
from jaxtyping import Float

from structid.core.streams import Purpose, derived_seed, stream
from structid.inference.error_models.base import ErrorModel
from structid.inference.likelihood.posterior import Posterior
from structid.inference.sample import sample
from structid.inference.sampling.moves import EnsembleState
from structid.inference.sampling.smc.lost_modes import Mode
from structid.inference.sampling.smc.reference_density import FromReference
from structid.inference.sampling.smc.smc import SMC
from structid.inference.sampling_result import SamplingResult
from structid.law_choice.cyclic_test import CyclicTest
from structid.mechanics.hysteretic_laws.base import HystereticLaw
from structid.models.hysteretic.hysteretic import Hysteretic
from structid.optimize.many_starts import FARTHEST, Minimum, minima_from_many_starts, refined
from structid.probability.space import ParameterSpace

SEARCHED = 600
"""Number of samples at which laws are searched; all turning points are among them."""
STARTS = {True: 64, False: 24}
"""Number of searches, for fast laws and for the others; they begin at the best of eight times as many draws."""
REFINED = 4
"""Number of minima of the search that are refined at all samples."""
REFINED_AGAIN = 2
"""Number of them that are refined with correlated errors."""
FINER = (1, 4, 16)
"""Divisions of the steps that are tried until the runs succeed."""
NEARBY = 0.3
"""Spread of further starts around a minimum, in standard deviations of the prior."""
ROUNDS = 3
"""Rounds in which the correlation of the errors and the parameters are estimated in turn."""
CORRELATIONS = 1e-3, 0.9999
"""Smallest and largest correlation of neighbouring errors."""
SAMPLERS = {
    True: SMC(particles=200, ensembles=2, steps=200, effective_share=0.5, correlation=0.3, independent=0.9, scouts=0),
    False: SMC(particles=100, ensembles=2, steps=100, effective_share=0.5, correlation=0.4, independent=0.9, scouts=0),
}
"""Samplers of the posterior, for fast laws and for those that divide the moves of a test into many steps."""
PILOT_STEPS = 60
"""Moves of the particles in the first run, around which the second reference density is fitted."""
MOST_RUNS = 3
"""Largest number of tempering runs."""
FAST = 0.1
"""Accurate move from which a law is fast."""
WIDER = 1.5
"""Factor of the standard deviations of the reference density: a mixture that is wider than the posterior loses no tail."""


@dataclass(frozen=True, eq=False)
class LawFit:
    """A law fitted to a test.

    Parameters
    ----------
    law : HystereticLaw
        The law.
    test : CyclicTest
        The test.
    errors : ErrorModel
        Error model.
    minimum : Minimum
        The largest posterior density, in standard-normal coordinates of the prior.
    correlation : float
        Correlation of neighbouring errors; zero for independent errors.
    known : tuple of str
        Parameters of the law that are not fitted.
    """

    law: HystereticLaw
    test: CyclicTest
    errors: ErrorModel
    minimum: Minimum = field(repr=False)
    correlation: float
    known: tuple[str, ...] = ()

    @cached_property
    def posterior(self) -> Posterior:
        """The posterior of the parameters, the force offset and the parameters of the errors."""
        return Posterior(self._space, self.model, self.test.observation, discrepancy=self.errors)

    @cached_property
    def _space(self) -> ParameterSpace:
        return self.test.priors(self.law, self.known)

    @cached_property
    def model(self) -> Hysteretic:
        """The model with the fitted parameters of the law and the force offset free."""
        return Hysteretic(self.law, free=self._space.names, channels=("restoring_force",))

    @cached_property
    def best(self) -> Float[np.ndarray, " parameter"]:
        """The parameters of largest posterior density, in SI."""
        return np.asarray(_theta_of(self._space, self.minimum.x[None])[0])

    def force(self, test: CyclicTest | None = None) -> Float[np.ndarray, " time"]:
        """Return the force of the best parameters under the displacements of a test, by default the fitted one."""
        along = test or self.test
        for finer in FINER:
            # Parameters from a part of a test may need shorter steps for the rest of it.
            model = replace(self.model, substeps=finer * self.model.substeps)
            run = model.simulate(self.best[None], along.path)
            if run.done[0]:
                break
        return np.asarray(run.values[0, along.rows, 0])

    def forces_of_draws(
        self, along: CyclicTest, count: int, rng: np.random.Generator
    ) -> Float[np.ndarray, "draw time"]:
        """Return forces of draws from the normal approximation of the posterior, without runs that fail [N]."""
        factor = np.linalg.cholesky(np.linalg.inv(self.minimum.curvature))
        x = self.minimum.x + rng.normal(size=(count, len(factor))) @ factor.T
        theta = _theta_of(self._space, np.clip(x, -FARTHEST, FARTHEST))
        runs = replace(self.model, substeps=4 * self.model.substeps).simulate(theta, along.path)
        return np.asarray(runs.values[runs.done][:, along.rows, 0])

    @cached_property
    def log_evidence(self) -> float:
        """Laplace's approximation of the log evidence, in standard-normal coordinates x of the prior and log error parameters ε.

        log Z ≈ log L − ½ |x|² − ½ log det(JᵀJ/s² + 1) + log p(ε) + ½ log((2π)^e det C)
        """
        count, minimum = len(self.test.force), self.minimum
        log_likelihood = -minimum.value - 0.5 * count * (np.log(2.0 * np.pi) + 1.0)
        log_likelihood += 0.5 * np.log1p(-(self.correlation**2))
        if self.correlation:
            log_likelihood += np.log(_relative_sd(self.correlation, np.diff(self.test.rows))).sum()
        marginals = self.posterior.space.marginals
        errors = [
            float(marginals[name].log_density(np.array([value]))[0]) + np.log(value)
            for name, value in self._error_parameters.items()
        ]
        volume = 0.5 * np.linalg.slogdet(2.0 * np.pi * self._covariance_of_errors())[1]
        return float(log_likelihood - 0.5 * np.linalg.slogdet(minimum.curvature)[1] + sum(errors) + volume)

    @property
    def _error_parameters(self) -> dict[str, float]:
        """Return σ², and the correlation time τ of correlated errors; the samples of a test are 1 s apart, whatever its rate."""
        variance = self.minimum.mean_square / (1.0 - self.correlation**2)
        if not self.correlation:
            return {"sigma2": variance}
        return {"sigma2": variance, "correlation_time": -1.0 / float(np.log(self.correlation))}

    def sampled(self, seed: int, store: Path | None = None) -> SamplingResult:
        """Return draws of the posterior, or stored draws, from tempering runs that begin at a reference density.

        The first reference is fitted to the normal approximation around the best fit, each further one to the particles of the run
        before: a curved posterior is wider than the normal approximation. The runs end when the draws have converged.
        """
        posterior, settings = self.posterior, SAMPLERS[self.law.accurate_move >= FAST]
        mode, rng = self._mode(), stream(seed, Purpose.HYSTERETIC_LAW)
        phi = mode.middle + rng.normal(size=(1, settings.particles, posterior.dimension)) @ mode.factor.T
        particles = EnsembleState(phi, posterior.evaluate(phi[0])[0][None])
        for run in range(MOST_RUNS):
            reference = FromReference(posterior, particles, [mode])
            kept = None if store is None else store.with_suffix(f".{run}.h5")
            run_seed = derived_seed(seed, Purpose.HYSTERETIC_LAW, run)
            steps = settings.steps if run else PILOT_STEPS
            result = replace(sample(reference, replace(settings, steps=steps), run_seed, kept), target=posterior)
            if run and result.verdict().converged:
                break
            last = posterior.bijection.inverse(result.history[-1].reshape(-1, posterior.dimension))
            particles = EnsembleState(
                last.reshape(settings.ensembles, settings.particles, -1), result.coordinate_log_density[-1]
            )
        return result

    def _mode(self) -> Mode:
        """Return the best fit and its spread in the unconstrained coordinates of the posterior."""
        posterior, names = self.posterior, self.model.free
        rest = [self._error_parameters[name] for name in posterior.names[len(names) :]]
        theta = np.append(self.best, rest)
        step = 1e-4
        moved = _theta_of(self._space, self.minimum.x + step * np.eye(len(names)))
        middle = posterior.bijection.inverse(theta[None])[0]
        ends = posterior.bijection.inverse(np.concatenate([moved, np.tile(rest, (len(names), 1))], axis=1))
        slopes = (ends - middle)[:, : len(names)] / step  # dφ/dx, diagonal for independent priors
        covariance = slopes.T @ np.linalg.inv(self.minimum.curvature) @ slopes
        whole = np.zeros((len(theta), len(theta)))
        whole[: len(names), : len(names)] = covariance
        # dφ/d log of the error parameters
        ends = posterior.bijection.inverse(theta * (1.0 + step * np.eye(len(theta))[len(names) :]))
        scale = np.diag((ends - middle)[:, len(names) :]) / step
        whole[len(names) :, len(names) :] = scale[:, None] * self._covariance_of_errors() * scale
        factor = WIDER * np.linalg.cholesky(whole + 1e-12 * np.eye(len(theta)))
        return Mode(middle, float(posterior.evaluate(middle[None])[0][0]), factor)

    def _covariance_of_errors(self) -> Float[np.ndarray, "error error"]:
        """Return the covariance of log σ², and of log τ for correlated errors.

        The innovations' variance σ² (1 − ρ²), ρ = e^(−1/τ), has the relative variance 2/n, and ρ the variance (1 − ρ²)/n. The
        samples determine the former better, so σ² and τ vary together.
        """
        count, rho = len(self.test.force), self.correlation
        if not rho:
            return np.array([[2.0 / count]])
        time = -1.0 / np.log(rho)
        of_time = min((1.0 - rho**2) * (time / rho) ** 2 / count, 1.0)
        along = 2.0 * rho**2 / ((1.0 - rho**2) * time)  # d log σ²/d log τ
        return np.array([[2.0 / count + along**2 * of_time, along * of_time], [along * of_time, of_time]])


def _theta_of(space: ParameterSpace, x: Float[np.ndarray, "run parameter"]) -> Float[np.ndarray, "run parameter"]:
    """Return parameters in SI from standard-normal coordinates of the prior."""
    return space.from_uniform(scipy.special.ndtr(x))


class _Residuals:
    """Residuals of a law along a test, relative to the largest force, whitened by a correlation."""

    def __init__(
        self,
        test: CyclicTest,
        law: HystereticLaw,
        correlation: float = 0.0,
        known: Collection[str] = (),
        finer: int = 1,
    ) -> None:
        self.test, self.correlation = test, correlation
        self.space = test.priors(law, known)
        self.model = Hysteretic(law, free=self.space.names, channels=("restoring_force",))
        # Only distant samples are divided: that takes fewer steps than as many for every sample.
        self.path, self.rows = test.divided(law.accurate_move / finer)

    def with_correlation(self, correlation: float) -> _Residuals:
        """Return the same residuals whitened by another correlation; the compiled model serves both."""
        other = copy.copy(self)
        other.correlation = correlation
        return other

    def __call__(self, x: Float[np.ndarray, "run parameter"]) -> Float[np.ndarray, "run value"]:
        theta = _theta_of(self.space, x)
        with np.errstate(over="ignore", invalid="ignore"):
            residuals = self.test.force - self.model.simulate(theta, self.path).values[:, self.rows, 0]
            return self.whitened(residuals / self.test.largest_force)

    def whitened(self, residuals: Float[np.ndarray, "run value"]) -> Float[np.ndarray, "run value"]:
        """Return √(1 − ρ²) r_0, r_t − ρ r_(t−1); a sample after g rows of the path has ρᵍ, and the same variance.

        r_t − ρᵍ r_(t−1) has the variance σ² (1 − ρ²ᵍ).
        """
        if not self.correlation:
            return residuals
        gaps = np.diff(self.test.rows)
        first = np.sqrt(1.0 - self.correlation**2) * residuals[:, :1]
        change = residuals[:, 1:] - self.correlation**gaps * residuals[:, :-1]
        return np.concatenate([first, change * _relative_sd(self.correlation, gaps)], axis=1)


def _relative_sd(correlation: float, gaps: np.ndarray) -> np.ndarray:
    """Return √((1 − ρ²)/(1 − ρ²ᵍ)), by which an innovation after g rows is divided."""
    return np.sqrt((1.0 - correlation**2) / (1.0 - correlation ** (2 * gaps)))


def search_law(test: CyclicTest, law: HystereticLaw, seed: int) -> list[Minimum]:
    """Return the minima for independent errors at some of the samples, the best first."""
    coarse = _Residuals(test.thinned(SEARCHED), law)
    rng = stream(seed, Purpose.HYSTERETIC_LAW)
    starts = STARTS[law.accurate_move >= FAST]
    return minima_from_many_starts(coarse, len(coarse.space.names), rng, starts)


def refine_law(
    test: CyclicTest, law: HystereticLaw, minima: list[Minimum], error_models: Sequence[ErrorModel]
) -> list[LawFit]:
    """Refine the best minima of a search at all samples, under every error model; an empty list if every run fails."""
    if not minima:
        return []
    for finer in FINER:
        # Minima of the search, which has fewer samples, may need shorter steps along all of them.
        whole = _Residuals(test, law, finer=finer)
        if best := refined(whole, np.stack([m.x for m in minima[:REFINED]]), 10):
            break
    else:
        return []
    return [
        LawFit(law, test, errors, _of_force(best[0], test), 0.0)
        if errors.describe()["kind"] == "iid"
        else _with_correlated_errors(whole, law, best, errors)
        for errors in error_models
    ]


def _with_correlated_errors(whole: _Residuals, law: HystereticLaw, best: list[Minimum], errors: ErrorModel) -> LawFit:
    """Refine minima for independent errors with the correlation of their residuals, in turn."""
    test, correlation = whole.test, 0.0
    for _ in range(ROUNDS):
        correlation = _neighbours(whole(best[0].x[None])[0], np.diff(test.rows))
        best = refined(whole.with_correlation(correlation), np.stack([m.x for m in best[:REFINED_AGAIN]]), 8)
    return LawFit(law, test, errors, _of_force(best[0], test), correlation)


def without_mechanism(fit: LawFit, name: str) -> LawFit:
    """Return a fit of the same law in which one parameter has the value at which it has no effect."""
    neutral = fit.law.parameters()[name].neutral
    law = fit.law.with_values({name: neutral})
    residuals = _Residuals(fit.test, law, fit.correlation, (name,))
    kept = [other != name for other in fit.model.free]
    start = fit.minimum.x[kept]
    nearby = start + NEARBY * stream(0, Purpose.HYSTERETIC_LAW).normal(size=(REFINED - 1, len(start)))
    best = refined(residuals, np.concatenate([start[None], nearby]), 12)
    return LawFit(law, fit.test, fit.errors, _of_force(best[0], fit.test), fit.correlation, (name,))


def _neighbours(residuals: Float[np.ndarray, " value"], gaps: np.ndarray) -> float:
    """Return the correlation of neighbouring residuals."""
    near = gaps == 1
    first, second = residuals[:-1][near], residuals[1:][near]
    return float(np.clip(first @ second / np.sqrt((first @ first) * (second @ second)), *CORRELATIONS))


def _of_force(minimum: Minimum, test: CyclicTest) -> Minimum:
    """Return a minimum of residuals relative to the largest force as one of residuals in N."""
    scale = test.largest_force
    count = len(test.force)
    return replace(minimum, value=minimum.value + count * np.log(scale), mean_square=minimum.mean_square * scale**2)
