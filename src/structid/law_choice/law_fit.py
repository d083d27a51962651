"""Fit of one hysteretic law to a test of a specimen under one error model: the best parameters, and the evidence."""

from __future__ import annotations

import copy
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import scipy.special
from jaxtyping import Float, Int

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
from structid.law_choice.specimen_test import SensorValues, SpecimenTest
from structid.mechanics.hysteretic_laws.base import HystereticLaw
from structid.models.finer_steps import in_finer_steps
from structid.models.hysteretic.hysteretic import Hysteretic
from structid.optimize.many_starts import FARTHEST, Minimum, minima_from_many_starts, refined
from structid.probability.space import ParameterSpace

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
WHITE = 0.2
"""Correlation of neighbouring errors below which they are noise of a sensor."""
CORRELATIONS = 1e-3, 0.9999
"""Smallest and largest correlation of neighbouring errors."""
SAMPLERS = {
    True: SMC(particles=200, ensembles=2, steps=200, effective_share=0.5, correlation=0.3, independent=0.9, scouts=0),
    False: SMC(
        particles=160,
        ensembles=2,
        steps=100,
        effective_share=0.5,
        correlation=0.4,
        independent=0.5,
        # With 15 parameters, correlation times are half of those with as many stretch moves.
        differential_evolution=0.9,
        scouts=0,
    ),
}
"""Samplers of the posterior, for fast laws and for those that divide the moves of a test into many steps."""
STEPS_OF_RUN = (0.5, 1.0, 2.5, 5.0)
"""Moves of the particles in each tempering run, relative to the sampler's; the first is a pilot for the next reference density."""
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
    correlations : tuple of float
        Correlation of neighbouring errors of every sensor; zero for independent errors.
    known : tuple of str
        Parameters of the law that are not fitted.
    """

    law: HystereticLaw
    test: SpecimenTest
    errors: ErrorModel
    minimum: Minimum = field(repr=False)
    correlations: tuple[float, ...]
    known: tuple[str, ...] = ()

    @cached_property
    def posterior(self) -> Posterior:
        """The posterior of the parameters of the law, of the sensors and of the errors."""
        return self.test.posterior(self.law, self.known, self.errors)

    @cached_property
    def _space(self) -> ParameterSpace:
        """Priors of the fitted parameters: those of the law, then those of the sensors."""
        return self.test.unknowns(self.law, self.known)

    @property
    def model(self) -> Hysteretic:
        """The model with the fitted parameters of the law free."""
        model = self.posterior.model
        assert isinstance(model, Hysteretic)
        return model

    @property
    def correlated(self) -> bool:
        """Whether the errors of neighbouring values are correlated."""
        return any(self.correlations)

    @cached_property
    def best(self) -> Float[np.ndarray, " parameter"]:
        """The parameters of largest posterior density, in SI."""
        return np.asarray(_theta_of(self._space, self.minimum.x[None])[0])

    @property
    def fitted(self) -> tuple[str, ...]:
        """Names of the fitted parameters."""
        return self._space.names

    def residuals(self, test: SpecimenTest) -> Float[np.ndarray, " value"]:
        """Return the residuals of the best parameters in a test of the same specimen, not finite if the run fails."""
        for finer in FINER:
            # Parameters from a part of a test may need shorter steps for the rest of it.
            residuals = np.asarray(test.residuals(self.law, self._space, finer)(self.best[None])[0])
            if np.isfinite(residuals).all():
                break
        return residuals

    @cached_property
    def _own_residuals(self) -> Float[np.ndarray, " value"]:
        """Residuals of the best parameters in the test to which they were fitted."""
        return self.residuals(self.test)

    @property
    def unexplained(self) -> float:
        """Residual variance of the best parameters over the variance of the measured values."""
        return self.test.unexplained(self._own_residuals)

    @cached_property
    def residual_correlation(self) -> float:
        """Correlation of neighbouring residuals of the best parameters; the largest of all sensors."""
        return _largest_correlation(self.test, self._own_residuals)

    @property
    def leaves_noise(self) -> bool:
        """Whether the residuals of the best parameters are noise of the sensors."""
        return self.residual_correlation < WHITE

    def force(self, along: CyclicTest) -> Float[np.ndarray, " time"]:
        """Return the force of the best parameters under the displacements of a cyclic test [N]."""
        for finer in FINER:
            run = in_finer_steps(self.model, finer).simulate(self.best[None], along.path)
            if run.done[0]:
                break
        return np.asarray(run.values[0, along.rows, 0])

    def forces(
        self, parameters: Float[np.ndarray, "draw parameter"], along: CyclicTest
    ) -> Float[np.ndarray, "run time"]:
        """Return forces of parameters under the displacements of a cyclic test, without runs that fail [N]."""
        runs = in_finer_steps(self.model, 4).simulate(parameters, along.path)
        return np.asarray(runs.values[runs.done][:, along.rows, 0])

    def normal_draws(self, count: int, rng: np.random.Generator) -> Float[np.ndarray, "draw parameter"]:
        """Return draws of the parameters from the normal approximation of the posterior, in SI."""
        x = self.minimum.x + rng.normal(size=(count, len(self.minimum.x))) @ self._spread.T
        return _theta_of(self._space, np.clip(x, -FARTHEST, FARTHEST))

    @cached_property
    def _curvature(self) -> tuple[Float[np.ndarray, " parameter"], Float[np.ndarray, "parameter parameter"]]:
        """Eigenvalues and eigenvectors of the curvature at the best fit, in standard-normal coordinates of the prior.

        The prior alone has a curvature of one. Where the data add up to 1e16, round-off hides it.
        """
        values, vectors = np.linalg.eigh(self.minimum.curvature)
        return np.maximum(values, 1.0), vectors

    @property
    def _spread(self) -> Float[np.ndarray, "parameter parameter"]:
        """Factor F of the covariance F Fᵀ around the best fit, in standard-normal coordinates of the prior."""
        values, vectors = self._curvature
        return np.asarray(vectors / np.sqrt(values))

    @cached_property
    def log_evidence(self) -> float:
        """Laplace's approximation of the log evidence, in standard-normal coordinates x of the prior and log error parameters ε.

        log Z ≈ log L − ½ |x|² − ½ log det(JᵀJ/s² + 1) + log p(ε) + ½ log((2π)^e det C)
        """
        log_likelihood, marginals = -self.minimum.value, self.posterior.space.marginals
        errors = volume = 0.0
        for sensor in self._sensors:
            count, rho = len(sensor.values.values), sensor.correlation
            log_likelihood -= 0.5 * count * (np.log(2.0 * np.pi) + 1.0)
            if rho:
                log_likelihood += 0.5 * np.log1p(-(rho**2)) + np.log(_relative_sd(rho, sensor.values.gaps)).sum()
            volume += 0.5 * np.linalg.slogdet(2.0 * np.pi * sensor.covariance_of_errors)[1]
            for name, value in sensor.error_parameters.items():
                errors += float(marginals[name].log_density(np.array([value]))[0]) + np.log(value)
        return float(log_likelihood - 0.5 * np.log(self._curvature[0]).sum() + errors + volume)

    @cached_property
    def _sensors(self) -> tuple[_FittedSensor, ...]:
        return tuple(
            _FittedSensor(values, float(square), rho, bound.observation.step, bound.labels)
            for values, square, rho, bound in zip(
                self.test.sensors,
                self.minimum.mean_squares,
                self.correlations,
                self.posterior.likelihood.of,
                strict=True,
            )
        )

    def sampled(self, seed: int, store: Path | None = None, runs: int = len(STEPS_OF_RUN)) -> SamplingResult:
        """Return draws of the posterior, or stored draws, from tempering runs that begin at a reference density.

        The first reference is fitted to the normal approximation around the best fit, each further one to the particles of the run
        before: a curved posterior is wider than the normal approximation. The runs end when the draws have converged, or after
        `runs` of them.
        """
        posterior, settings = self.posterior, SAMPLERS[self.law.accurate_move >= FAST]
        mode, rng = self._mode(), stream(seed, Purpose.HYSTERETIC_LAW)
        phi = mode.middle + rng.normal(size=(1, settings.particles, posterior.dimension)) @ mode.factor.T
        particles = EnsembleState(phi, posterior.evaluate(phi[0])[0][None])
        for run in range(runs):
            reference = FromReference(posterior, particles, [mode])
            kept = None if store is None else store.with_suffix(f".{run}.h5")
            run_seed = derived_seed(seed, Purpose.HYSTERETIC_LAW, run)
            steps = int(settings.steps * STEPS_OF_RUN[run])
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
        posterior, names = self.posterior, list(self.posterior.names)
        fitted = [names.index(name) for name in self._space.names]
        theta, logarithmic = np.empty(len(names)), np.zeros((len(names), len(names)))
        theta[fitted] = self.best
        for sensor in self._sensors:
            places = [names.index(name) for name in sensor.error_parameters]
            theta[places] = list(sensor.error_parameters.values())
            logarithmic[np.ix_(places, places)] = sensor.covariance_of_errors
        errors = [place for place in range(len(names)) if place not in fitted]
        step = 1e-4
        moved = np.tile(theta, (len(names), 1))
        moved[: len(fitted), fitted] = _theta_of(self._space, self.minimum.x + step * np.eye(len(fitted)))
        for row, place in enumerate(errors, start=len(fitted)):
            moved[row, place] *= 1.0 + step
        middle = posterior.bijection.inverse(theta[None])[0]
        # dφ/dx of the fitted parameters, and dφ/d log of the error parameters
        slopes = (posterior.bijection.inverse(moved) - middle) / step
        covariance = np.zeros((len(names), len(names)))
        covariance[: len(fitted), : len(fitted)] = self._spread @ self._spread.T
        covariance[len(fitted) :, len(fitted) :] = logarithmic[np.ix_(errors, errors)]
        whole = slopes.T @ covariance @ slopes
        factor = WIDER * np.linalg.cholesky(whole + 1e-12 * np.eye(len(theta)))
        return Mode(middle, float(posterior.evaluate(middle[None])[0][0]), factor)


@dataclass(frozen=True)
class _FittedSensor:
    """Errors of one sensor in a fit."""

    values: SensorValues
    mean_square: float  # of the whitened residuals
    correlation: float  # of neighbouring errors
    step: float  # time between neighbouring values [s]
    labels: Mapping[str, str]  # names of the error parameters in the posterior

    @property
    def error_parameters(self) -> dict[str, float]:
        """σ², and the correlation time τ of correlated errors, by their names in the posterior."""
        variance = self.mean_square / (1.0 - self.correlation**2)
        if not self.correlation:
            return {self.labels["sigma2"]: variance}
        time = -self.step / float(np.log(self.correlation))
        return {self.labels["sigma2"]: variance, self.labels["correlation_time"]: time}

    @property
    def covariance_of_errors(self) -> Float[np.ndarray, "error error"]:
        """Covariance of log σ², and of log τ for correlated errors.

        The innovations' variance σ² (1 − ρ²), ρ = e^(−Δt/τ), has the relative variance 2/n, and ρ the variance (1 − ρ²)/n. The
        samples determine the former better, so σ² and τ vary together.
        """
        count, rho = len(self.values.values), self.correlation
        if not rho:
            return np.array([[2.0 / count]])
        time = -1.0 / np.log(rho)  # in steps
        of_time = min((1.0 - rho**2) * (time / rho) ** 2 / count, 1.0)
        along = 2.0 * rho**2 / ((1.0 - rho**2) * time)  # d log σ²/d log τ
        return np.array([[2.0 / count + along**2 * of_time, along * of_time], [along * of_time, of_time]])


def _theta_of(space: ParameterSpace, x: Float[np.ndarray, "run parameter"]) -> Float[np.ndarray, "run parameter"]:
    """Return parameters in SI from standard-normal coordinates of the prior."""
    return space.from_uniform(scipy.special.ndtr(x))


class _Residuals:
    """Residuals of a law in a test, relative to the largest value of each sensor, whitened by a correlation of each sensor."""

    def __init__(
        self,
        test: SpecimenTest,
        law: HystereticLaw,
        correlations: tuple[float, ...] = (),
        known: Collection[str] = (),
        finer: int = 1,
    ) -> None:
        self.test, self.correlations = test, correlations
        self.space = test.unknowns(law, known)
        self._in_si = test.residuals(law, self.space, finer)

    def with_correlations(self, correlations: tuple[float, ...]) -> _Residuals:
        """Return the same residuals whitened by other correlations; the compiled model serves both."""
        other = copy.copy(self)
        other.correlations = correlations
        return other

    def __call__(self, x: Float[np.ndarray, "run parameter"]) -> Float[np.ndarray, "run value"]:
        with np.errstate(over="ignore", invalid="ignore"):
            residuals = np.asarray(self._in_si(_theta_of(self.space, x)) / self.test.scales)
            if not any(self.correlations):
                return residuals
            each = zip(self.test.blocks, self.test.sensors, self.correlations, strict=True)
            return np.concatenate([whitened(residuals[:, b], s.gaps, rho) for b, s, rho in each], axis=1)

    def refined(self, minima: list[Minimum], count: int, iterations: int) -> list[Minimum]:
        """Return the minima that searches from some minima reach, the best first."""
        return refined(self, np.stack([m.x for m in minima[:count]]), iterations, self.test.blocks)


def whitened(
    residuals: Float[np.ndarray, "run value"], gaps: Int[np.ndarray, " interval"], correlation: float
) -> Float[np.ndarray, "run value"]:
    """Return √(1 − ρ²) r_0, r_t − ρ r_(t−1); a value after g steps has ρᵍ, and the same variance.

    r_t − ρᵍ r_(t−1) has the variance σ² (1 − ρ²ᵍ).
    """
    first = np.sqrt(1.0 - correlation**2) * residuals[:, :1]
    change = residuals[:, 1:] - correlation**gaps * residuals[:, :-1]
    return np.concatenate([first, change * _relative_sd(correlation, gaps)], axis=1)


def _relative_sd(correlation: float, gaps: np.ndarray) -> np.ndarray:
    """Return √((1 − ρ²)/(1 − ρ²ᵍ)), by which an innovation after g steps is divided."""
    return np.sqrt((1.0 - correlation**2) / (1.0 - correlation ** (2 * gaps)))


def search_law(searched: SpecimenTest, law: HystereticLaw, seed: int, give_up: float = np.inf) -> list[Minimum]:
    """Return the minima for independent errors, the best first; a search whose values stay above `give_up` ends early."""
    residuals, rng = _Residuals(searched, law), stream(seed, Purpose.HYSTERETIC_LAW)
    starts = STARTS[law.accurate_move >= FAST]
    dimension = len(residuals.space.names)
    return minima_from_many_starts(residuals, dimension, rng, starts, blocks=searched.blocks, give_up=give_up)


def errors_are_white(searched: SpecimenTest, law: HystereticLaw, minimum: Minimum) -> bool:
    """Whether the residuals at a minimum of a search are noise: neighbours do not share it."""
    return _largest_correlation(searched, _Residuals(searched, law)(minimum.x[None])[0]) < WHITE


def _largest_correlation(test: SpecimenTest, residuals: Float[np.ndarray, " value"]) -> float:
    """Return the correlation of neighbouring residuals; the largest of all sensors."""
    each = zip(test.blocks, test.sensors, strict=True)
    return max(neighbours(residuals[block], sensor.gaps) for block, sensor in each)


def refine_law(
    test: SpecimenTest, law: HystereticLaw, minima: list[Minimum], error_models: Sequence[ErrorModel]
) -> list[LawFit]:
    """Refine the best minima of a search at all samples, under every error model; an empty list if every run fails."""
    if not minima:
        return []
    for finer in FINER:
        # Minima of the search, which has fewer samples, may need shorter steps along all of them.
        whole = _Residuals(test, law, finer=finer)
        if best := whole.refined(minima, REFINED, 10):
            break
    else:
        return []
    return [
        LawFit(law, test, errors, _in_si(best[0], test), (0.0,) * len(test.sensors))
        if errors.describe()["kind"] == "iid"
        else _with_correlated_errors(whole, law, best, errors)
        for errors in error_models
    ]


def _with_correlated_errors(whole: _Residuals, law: HystereticLaw, best: list[Minimum], errors: ErrorModel) -> LawFit:
    """Refine minima for independent errors with the correlations of their residuals, in turn."""
    test = whole.test
    correlations: tuple[float, ...] = ()
    for _ in range(ROUNDS):
        residuals = whole(best[0].x[None])[0]
        each = zip(test.blocks, test.sensors, strict=True)
        correlations = tuple(neighbours(residuals[block], sensor.gaps) for block, sensor in each)
        best = whole.with_correlations(correlations).refined(best, REFINED_AGAIN, 8)
    return LawFit(law, test, errors, _in_si(best[0], test), correlations)


def without_mechanism(fit: LawFit, name: str) -> LawFit:
    """Return a fit of the same law in which one parameter has the value at which it has no effect."""
    neutral = fit.law.parameters()[name].neutral
    law = fit.law.with_values({name: neutral})
    residuals = _Residuals(fit.test, law, fit.correlations, (name,))
    kept = [other != name for other in fit.fitted]
    start = fit.minimum.x[kept]
    nearby = start + NEARBY * stream(0, Purpose.HYSTERETIC_LAW).normal(size=(REFINED - 1, len(start)))
    best = refined(residuals, np.concatenate([start[None], nearby]), 12, fit.test.blocks)
    return LawFit(law, fit.test, fit.errors, _in_si(best[0], fit.test), fit.correlations, (name,))


def neighbours(residuals: Float[np.ndarray, " value"], gaps: Int[np.ndarray, " interval"]) -> float:
    """Return the correlation of neighbouring residuals."""
    near = gaps == 1
    first, second = residuals[:-1][near], residuals[1:][near]
    return float(np.clip(first @ second / np.sqrt((first @ first) * (second @ second)), *CORRELATIONS))


def _in_si(minimum: Minimum, test: SpecimenTest) -> Minimum:
    """Return a minimum of residuals relative to the largest values as one of residuals in SI."""
    largest = np.array([sensor.largest for sensor in test.sensors])
    return replace(
        minimum,
        value=minimum.value + float(np.log(test.scales).sum()),
        mean_squares=minimum.mean_squares * largest**2,
    )
