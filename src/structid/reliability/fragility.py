"""Probability that a structure exceeds a limit or fails, given the data, for records of increasing strength."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy
from jaxtyping import Float

from structid.core.errors import InputError, Status
from structid.core.hashing import digest
from structid.core.journal import Journal
from structid.core.notebook import ShownAsText
from structid.core.progress import Progress
from structid.core.streams import Purpose, stream
from structid.core.validation import check_arguments
from structid.ground_motion.record import GroundMotion
from structid.inference.likelihood.posterior import Posterior
from structid.inference.prediction.parameter_drift import ParameterDrift
from structid.inference.prediction.prediction import Predictor
from structid.models.base import Model
from structid.reliability.corrected_share import corrected_share
from structid.reliability.stand_in import fitted_stand_in
from structid.surrogates.base import SurrogateSettings

if TYPE_CHECKING:
    from matplotlib.figure import Figure

RESAMPLES = 200
"""Number of resamples of the records and draws for the standard errors of the fitted curve."""


@dataclass(frozen=True, eq=False)
class Fragility(ShownAsText):
    """Probability of a passage or a failure, given the data, as a function of the strength of the ground motion.

    Parameters
    ----------
    channel : str
        Channel whose absolute value is compared with the limit.
    limit : float
        Limit in the channel's SI unit.
    levels : ndarray, shape (level,)
        Peak ground accelerations [m/s²].
    records : tuple of str
        Names of the records.
    passed : ndarray, shape (draw, record, level)
        1 if the response passes the limit or the structure fails, 0 otherwise; NaN if the run failed for another reason.
    of_each : ndarray, shape (record, level)
        Probability for each record, over the draws; corrected by model runs where a surrogate replaced the model.
    error_of_each : ndarray, shape (record, level)
        Standard error of `of_each`, from the number of draws and from the correction.
    true_runs : int
        Number of model runs.
    seed : int
        Seed of the resampling.
    """

    channel: str
    limit: float
    levels: Float[np.ndarray, " level"]
    records: tuple[str, ...]
    passed: Float[np.ndarray, "draw record level"] = field(repr=False)
    of_each: Float[np.ndarray, "record level"] = field(repr=False)
    error_of_each: Float[np.ndarray, "record level"] = field(repr=False)
    true_runs: int
    seed: int = 0

    @property
    def probability(self) -> np.ndarray:
        """Mean over the records, shape (level,)."""
        return np.asarray(self.of_each.mean(axis=0))

    @property
    def error(self) -> np.ndarray:
        """Standard error of `probability`, shape (level,): from the scatter over the records; for one record, from the draws."""
        count = len(self.records)
        within = np.sqrt((self.error_of_each**2).sum(axis=0)) / count
        if count == 1:
            return np.asarray(within)
        return np.asarray(np.maximum(self.of_each.std(axis=0, ddof=1) / np.sqrt(count), within))

    def band(self, probability: float = 0.9) -> tuple[np.ndarray, np.ndarray]:
        """Central interval, over the draws, of the fraction of records with a passage: the posterior uncertainty.

        Parameters
        ----------
        probability : float
            Probability of the interval.

        Returns
        -------
        tuple of ndarray, shape (level,)
            Lower and upper bounds.
        """
        finite = np.isfinite(self.passed).sum(axis=1)
        shares = np.where(finite > 0, np.nansum(self.passed, axis=1) / np.maximum(finite, 1), np.nan)
        tail = 0.5 * (1.0 - probability)
        low, high = np.nanquantile(shares, [tail, 1.0 - tail], axis=0, method="inverted_cdf")
        return low, high

    @cached_property
    def curve(self) -> tuple[float, float]:
        """Median θ [m/s²] and dispersion β of the fitted curve Φ(ln(a/θ)/β); NaN if the levels do not determine them.

        The fit maximises the likelihood of the number of records that pass (J. W. Baker 2015, doi 10.1193/021113EQS025M).
        """
        return _lognormal(self.levels, self.probability, len(self.records))

    @cached_property
    def curve_error(self) -> tuple[float, float]:
        """Standard errors of ln θ and of β by resampling; NaN if too few resamples determine a curve."""
        if len(self._resampled) < RESAMPLES // 2:
            return float("nan"), float("nan")
        return float(np.log(self._resampled[:, 0]).std(ddof=1)), float(self._resampled[:, 1].std(ddof=1))

    @cached_property
    def _resampled(self) -> np.ndarray:
        """Median and dispersion of the curves of resampled records and draws, where determined, shape (resample, 2)."""
        rng = stream(self.seed, Purpose.FRAGILITY_RESAMPLES)
        draws, records, _ = self.passed.shape
        curves = []
        for _ in range(RESAMPLES):
            rows, columns = rng.integers(draws, size=draws), rng.integers(records, size=records)
            shares = np.nanmean(self.passed[rows][:, columns], axis=(0, 1))
            curves.append(_lognormal(self.levels, shares, records))
        fits = np.array(curves)
        return np.asarray(fits[np.isfinite(fits).all(axis=1)])

    def curve_band(self, at: Float[np.ndarray, " point"], probability: float = 0.9) -> tuple[np.ndarray, np.ndarray]:
        """Central interval of the fitted curve over resamples of the records and draws.

        Parameters
        ----------
        at : ndarray, shape (point,)
            Peak ground accelerations [m/s²].
        probability : float
            Probability of the interval.

        Returns
        -------
        tuple of ndarray, shape (point,)
            Lower and upper bounds; NaN if too few resamples determine a curve.
        """
        if len(self._resampled) < RESAMPLES // 2:
            return np.full(len(at), np.nan), np.full(len(at), np.nan)
        curves = scipy.stats.norm.cdf(np.log(at / self._resampled[:, :1]) / self._resampled[:, 1:])
        tail = 0.5 * (1.0 - probability)
        low, high = np.quantile(curves, [tail, 1.0 - tail], axis=0)
        return low, high

    def plot(self, save: str | os.PathLike[str] | None = None) -> Figure:
        """Draw the probabilities, the fitted curve and the band.

        Parameters
        ----------
        save : path-like, optional
            File name without extension; a PNG and a PDF are written.

        Returns
        -------
        Figure
            Figure with one panel.
        """
        from structid.figures import fragility as figures

        at = np.linspace(0.5 * self.levels.min(), self.levels.max(), 200)
        fitted = scipy.stats.norm.cdf(np.log(at / self.curve[0]) / self.curve[1])
        words = f"Φ(ln(a/{self.curve[0]:.3g}) / {self.curve[1]:.2f})"
        return figures.curve(
            self.levels,
            self.of_each,
            self.probability,
            self.error,
            self.band(),
            (at, fitted, *self.curve_band(at)),
            words,
            save=save,
        )

    def __str__(self) -> str:
        lines = [
            f"Fragility: {self.channel} over {self.limit:g}, {len(self.records)} record{'s'[: len(self.records) > 1]}, "
            f"{self.true_runs} model runs"
        ]
        low, high = self.band()
        for each in zip(self.levels, self.probability, self.error, low, high, strict=True):
            lines.append("  {:7.3f} m/s²   {:.3f} ± {:.3f}   90 % of the draws {:.2f} to {:.2f}".format(*each))
        median, dispersion = self.curve
        if np.isfinite(median):
            lines.append(f"  median {median:.3g} m/s², dispersion {dispersion:.2f}")
        return "\n".join(lines)


@check_arguments
def fragility(
    posterior: Posterior,
    draws: np.ndarray,
    records: Sequence[GroundMotion],
    channel: str,
    limit: float,
    levels: Sequence[float] | None = None,
    *,
    drift: ParameterDrift | None = None,
    surrogate: SurrogateSettings | None = None,
    training: int = 60,
    checks: int = 30,
    seed: int = 0,
    store: str | os.PathLike[str] | None = None,
    progress: Progress | None = None,
) -> Fragility:
    """Estimate the probability that a structure exceeds a limit or fails, given the data.

    Responses are predicted as in `predict`: with the model error if the channel was measured, and with parameter drift. Each draw
    is simulated for each record and level. For an expensive model, one surrogate per record and level is fitted to `training`
    draws. The model also simulates another `checks` draws, and the surrogate's errors there correct the estimate. The estimate
    is unbiased for any surrogate, and its standard error includes the uncertainty of the correction.

    Parameters
    ----------
    posterior : Posterior
        Posterior with the model itself, not a surrogate.
    draws : ndarray, shape (draw, parameter)
        Posterior draws in SI, such as ``result.thinned(200)``.
    records : sequence of GroundMotion
        Records of possible earthquakes.
    channel : str
        Channel whose absolute value is compared with the limit; a measured channel includes the model error.
    limit : float
        Limit in the channel's SI unit.
    levels : sequence of float, optional
        Peak ground accelerations [m/s²] to which every record is scaled; default for a single record: its own peak.
    drift : ParameterDrift, optional
        See `predict`.
    surrogate : SurrogateSettings, optional
        Surrogate that replaces the model for most draws, such as ``PODKriging()``; default: every draw is a model run.
    training, checks : int
        Number of draws to which the surrogate is fitted, and number of draws that correct it.
    seed : int
        Seed of the random numbers.
    store : path-like, optional
        File for finished results; a killed computation continues from it.
    progress : callable, optional
        Called with the number of finished pairs of record and level, and the total number of pairs.

    Returns
    -------
    Fragility
        Probabilities with their standard errors, and the band of posterior uncertainty.

    Raises
    ------
    InputError
        If there are no records, several records without levels, a limit or level that is not positive, or too few draws.
    StoreMismatchError
        If `store` belongs to another computation.

    Examples
    --------
    >>> import structid as si
    >>> curve = si.fragility(posterior, result.flat, records, "displacement", limit=0.05)  # doctest: +SKIP
    >>> curve.plot(save="fragility.png")  # doctest: +SKIP
    """
    draws = np.asarray(draws, dtype=float)
    motions = _scaled(records, levels)
    if not limit > 0.0:
        raise InputError("fragility(limit)", f"{limit:g}", "a positive limit")
    if surrogate is not None and len(draws) < training + checks + 1:
        raise InputError(
            "fragility(draws)",
            f"{len(draws)} draws",
            f"more than {training + checks} draws: {training} train the surrogate and {checks} check it",
        )
    pair = _Pair(posterior, draws, channel, float(limit), drift, surrogate, training, checks, seed)
    journal = None if store is None else Journal(store, pair.identity(motions))
    result = [] if journal is None else [_read(entry) for entry in journal]
    every = [motion for of_one in motions for motion in of_one]
    for number in range(len(result), len(every)):
        result.append(pair.simulated(every[number]))
        if journal is not None:
            journal.append(_entry(result[-1]))
        if progress is not None:
            progress(number + 1, len(every))
    shape = len(motions), len(motions[0])
    passed = np.stack([p for p, _, _ in result], axis=1).reshape(len(draws), *shape)
    shares, errors = (np.array([each[k] for each in result]).reshape(shape) for k in (1, 2))
    heights = np.array([motion.pga for motion in motions[0]] if levels is None else levels, dtype=float)
    names = tuple(record.name for record in records)
    return Fragility(channel, float(limit), heights, names, passed, shares, errors, len(every) * pair.true_runs, seed)


Found = tuple[np.ndarray, float, float]
"""Passages, their fraction and its standard error, for one record at one level."""


def _entry(found: Found) -> dict[str, np.ndarray]:
    return {"passed": found[0], "share": np.array(found[1:])}


def _read(entry: Mapping[str, np.ndarray]) -> Found:
    share, error = map(float, entry["share"])
    return np.asarray(entry["passed"]), share, error


@dataclass(frozen=True, eq=False)
class _Pair:
    """The computation that is repeated for every record at every level."""

    posterior: Posterior
    draws: np.ndarray
    channel: str
    limit: float
    drift: ParameterDrift | None
    surrogate: SurrogateSettings | None
    training: int
    checks: int
    seed: int

    @property
    def true_runs(self) -> int:
        """Number of model runs."""
        return len(self.draws) if self.surrogate is None else self.training + self.checks

    def identity(self, motions: list[list[GroundMotion]]) -> dict[str, Any]:
        """Return all inputs on which the result depends."""
        settings = None if self.surrogate is None else [repr(self.surrogate), self.training, self.checks]
        return {
            "posterior": self.posterior.content_hash,
            "draws": digest(self.draws),
            "asked": digest([self.channel, self.limit, self.seed, self.drift is not None, settings]),
            "records": digest([[motion.content_hash for motion in of_one] for of_one in motions]),
        }

    @cached_property
    def predictor(self) -> Predictor:
        return Predictor(self.posterior, self.draws, self.seed, self.drift, scaled=self.surrogate is None)

    @cached_property
    def checking(self) -> Predictor:
        """Predictor of the check draws; it adds the same random errors to the responses of surrogate and model."""
        some = self.draws[self.training : self.training + self.checks]
        return Predictor(self.posterior, some, self.seed, self.drift, scaled=False)

    def simulated(self, motion: GroundMotion) -> Found:
        if self.surrogate is None:
            result = self.passed(self.predictor, motion)
            return result, *corrected_share(result, result[:0], result[:0])
        stand_in = fitted_stand_in(self.posterior, self.draws[: self.training], motion, self.channel, self.surrogate)
        if stand_in is None:  # nearly all draws fail: use the training and check runs as the sample
            return self.without(motion)
        result = self.passed(self.predictor, motion, stand_in)
        both = (self.passed(self.checking, motion, model) for model in (stand_in, None))
        return result, *corrected_share(result, *both)

    def without(self, motion: GroundMotion) -> Found:
        """Use model runs of the first draws only."""
        some = self.draws[: self.training + self.checks]
        passed = np.full(len(self.draws), np.nan)
        passed[: len(some)] = self.passed(Predictor(self.posterior, some, self.seed, self.drift, scaled=False), motion)
        return passed, *corrected_share(passed, passed[:0], passed[:0])

    def passed(self, predictor: Predictor, motion: GroundMotion, stand_in: Model | None = None) -> np.ndarray:
        """Return 1 for a draw with a passage, 0 for a draw without, NaN for a failed run; shape (draw,)."""
        prediction = predictor.on(motion, (self.channel,), stand_in=stand_in)
        status: Any = prediction.status
        passed = np.where(status == Status.STRUCTURE_FAILED, 1.0, np.nan)
        passed[status == Status.DONE] = prediction.peaks[:, 0] > self.limit
        return passed


def _scaled(records: Sequence[GroundMotion], levels: Sequence[float] | None) -> list[list[GroundMotion]]:
    """Scale every record to every level."""
    if not len(records):
        raise InputError("fragility(records)", "no record", "one or more records")
    if levels is None:
        if len(records) > 1:
            raise InputError(
                "fragility(levels)", f"no levels for {len(records)} records", "peak ground accelerations [m/s²]"
            )
        return [[records[0]]]
    if not len(levels) or min(levels) <= 0.0:
        raise InputError(
            "fragility(levels)", f"{list(levels)}", "one or more positive peak ground accelerations [m/s²]"
        )
    return [[record.scale_to_pga(level) for level in levels] for record in records]


def _lognormal(levels: np.ndarray, shares: np.ndarray, records: int) -> tuple[float, float]:
    """Median and dispersion of the maximum-likelihood curve, given the fractions of `records` records."""
    determined = np.ptp(shares) > 0.0 and len(levels) > 1
    if not determined:
        return float("nan"), float("nan")

    def unlikely(parameters: np.ndarray) -> tuple[float, np.ndarray]:
        """−Σ R (s ln p + (1 − s) ln(1 − p)) with p = Φ(z), z = (ln a − ln θ)/β; and its gradient in (ln θ, ln β)."""
        beta = np.exp(parameters[1])
        z = (np.log(levels) - parameters[0]) / beta
        p = np.clip(scipy.special.ndtr(z), 1e-9, 1.0 - 1e-9)
        value = -records * np.sum(shares * np.log(p) + (1.0 - shares) * np.log1p(-p))
        slope = -records * (shares / p - (1.0 - shares) / (1.0 - p)) * np.exp(-0.5 * z**2) / np.sqrt(2.0 * np.pi)
        return float(value), np.array([-np.sum(slope / beta), -np.sum(slope * z)])

    start = [np.interp(0.5, np.maximum.accumulate(shares), np.log(levels)), np.log(0.3)]
    bounds = [(np.log(levels).min() - 3.0, np.log(levels).max() + 3.0), (np.log(0.01), np.log(5.0))]
    optimum = scipy.optimize.minimize(unlikely, start, jac=True, method="L-BFGS-B", bounds=bounds)
    return float(np.exp(optimum.x[0])), float(np.exp(optimum.x[1]))
