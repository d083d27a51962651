"""Response-space surrogates for given records: principal components of the history, and a chaos expansion or Kriging of each."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np

from structid.errors import InputError
from structid.ground_motion.excitation import Excitation
from structid.models.face import Progress, response_key
from structid.probability.space import Design
from structid.runs import Runs
from structid.surrogates.chaos.chaos_expansion import ChaosExpansion
from structid.surrogates.chaos.pce import PCE
from structid.surrogates.face import (
    Fit,
    Stopwatch,
    Surrogate,
    check_enough,
    common_step,
    fitted_range,
    fitting_runs,
    run_digests,
)
from structid.surrogates.kriging.predictor import KrigingPredictor
from structid.surrogates.kriging.universal_kriging import Kriging
from structid.surrogates.named_arrays import found_under, put_under
from structid.surrogates.progress import Stages

Predictor = ChaosExpansion | KrigingPredictor
_Regression = Callable[[str, Design, np.ndarray, Progress], Predictor]
"""Fits the scores on the record of a content hash."""


@dataclass(frozen=True)
class PODKriging:
    """Settings: principal components of the histories, y(t, θ) ≈ ȳ(t) + Σ_k φ_k(t) c_k(θ), each score a Kriging.

    Parameters
    ----------
    kriging : Kriging
        How the scores are interpolated. By default they share one correlation, weighted by their energy.
    left_out_energy : float
        Components are kept until they leave out this share of the variance.
    limit : float
        Largest mean relative error with which it may stand in a posterior.
    outside : {"warn", "refuse", "allow"}
        What to do with parameters beyond the range of the design.
    """

    kriging: Kriging = field(default_factory=Kriging)
    left_out_energy: float = 1e-8
    limit: float = 1e-2
    outside: Literal["warn", "refuse", "allow"] = "warn"

    def __post_init__(self) -> None:
        _check_energy(self.left_out_energy)

    def check(self, design: Design, records: Sequence[Excitation], channels: Sequence[str]) -> None:
        """Check the settings against runs that are yet to be made.

        Parameters
        ----------
        design : Design
            Their points.
        records : sequence of Excitation
            What will drive them, dealt out in turn.
        channels : sequence of str
            What they will return; any will do.

        Raises
        ------
        InputError
            If no surrogate can be fitted to them: too few on each record, or records of different steps.
        """
        _check("PODKriging", design, records)

    def fit(
        self, runs: Runs, progress: Progress | None = None, start: ResponseSpaceSurrogate | None = None
    ) -> ResponseSpaceSurrogate:
        """Fit to runs on one record or several.

        Parameters
        ----------
        runs : Runs
            Of the model it is to stand for; failed ones are left out.
        progress : callable, optional
            Told how far the fit is, in hundredths.
        start : ResponseSpaceSurrogate, optional
            One fitted to some of these runs, whose correlation lengths the search starts from; see `Kriging.fit`.

        Returns
        -------
        ResponseSpaceSurrogate
            A model for those records.
        """
        known = {} if start is None else start.records

        def regression(content_hash: str, design: Design, scores: np.ndarray, tell: Progress) -> KrigingPredictor:
            before = known[content_hash].scores if content_hash in known else None
            return self.kriging.fit(design, scores, tell, before if isinstance(before, KrigingPredictor) else None)

        return _fit(self, regression, runs, progress)


@dataclass(frozen=True)
class PODPCE:
    """Settings: principal components of the histories, each score a polynomial chaos expansion.

    Parameters
    ----------
    pce : PCE
        How the scores are expanded. By default with coefficients that shrink with the degree; sparse expansions of a hundred
        scores take minutes and are a hundred times less accurate.
    left_out_energy, limit, outside
        As for `PODKriging`.
    """

    pce: PCE = field(default_factory=lambda: PCE(method="shrinkage"))
    left_out_energy: float = 1e-8
    limit: float = 1e-2
    outside: Literal["warn", "refuse", "allow"] = "warn"

    def __post_init__(self) -> None:
        _check_energy(self.left_out_energy)

    def check(self, design: Design, records: Sequence[Excitation], channels: Sequence[str]) -> None:
        """Check the settings against runs that are yet to be made; see `PODKriging.check`.

        Parameters
        ----------
        design : Design
            Their points.
        records : sequence of Excitation
            What will drive them, dealt out in turn.
        channels : sequence of str
            What they will return; any will do.
        """
        _check("PODPCE", design, records)
        self.pce.check_runs(design.space.dimension, len(design) // len(records))

    def fit(self, runs: Runs, progress: Progress | None = None) -> ResponseSpaceSurrogate:
        """Fit to runs on one record or several; see `PODKriging.fit`.

        Parameters
        ----------
        runs : Runs
            Of the model it is to stand for; failed ones are left out.
        progress : callable, optional
            Told how far the fit is, in hundredths.

        Returns
        -------
        ResponseSpaceSurrogate
            A model for those records.
        """
        return _fit(self, lambda _hash, design, scores, tell: self.pce.fit(design, scores, tell), runs, progress)


@dataclass(frozen=True, eq=False)
class RecordFit:
    """The surrogate on one record.

    Parameters
    ----------
    name : str
        Of the record.
    samples : int
        Its length.
    mean : ndarray, shape (time · channel,)
        Mean history, scaled.
    modes : ndarray, shape (component, time · channel)
        Orthonormal φ_k, scaled.
    truncation : ndarray, shape (time · channel,)
        Standard deviation over the design of what the components leave out, scaled.
    scale : ndarray, shape (channel,)
        SI value of one scaled unit.
    scores : ChaosExpansion or KrigingPredictor
        c_k(θ).
    score_deviation : ndarray, shape (component,)
        Root mean square of the leave-one-out residuals of each score.
    """

    name: str
    samples: int
    mean: np.ndarray
    modes: np.ndarray
    truncation: np.ndarray
    scale: np.ndarray
    scores: Predictor
    score_deviation: np.ndarray

    @property
    def error(self) -> float:
        """Mean leave-one-out error relative to the histories' own spread."""
        left_out = np.sum(self.score_deviation**2) + np.sum(self.truncation**2)
        return float(left_out / self._mean_spread)

    @property
    def _mean_spread(self) -> float:
        # Σ (y − ȳ)² over time, in the mean over the design: of the mean history, and of what varies about it.
        shape = (self.samples, -1)
        centred = self.mean.reshape(shape) - self.mean.reshape(shape).mean(axis=0)
        modes = self.modes.reshape(len(self.modes), *centred.shape)
        modes = modes - modes.mean(axis=1, keepdims=True)
        variance = np.asarray(self._score_variance)
        return float(np.sum(centred**2) + variance @ np.sum(modes**2, axis=(1, 2)))

    @property
    def _score_variance(self) -> np.ndarray:
        return self.score_deviation**2 / np.maximum(self.scores.leave_one_out_error, 1e-300)


def _check_energy(left_out: float) -> None:
    if not 0 <= left_out < 1:
        raise InputError("left_out_energy", f"{left_out}", "a share, 0 or more and below 1")


def _check(kind: str, design: Design, records: Sequence[Excitation]) -> None:
    common_step(f"{kind}.fit", records)
    fewest = len(design) // len(records)
    check_enough(f"{kind}.fit", fewest, f"{fewest} runs on each of {len(records)} records")


def _fit(
    settings: PODKriging | PODPCE, regression: _Regression, runs: Runs, progress: Progress | None
) -> ResponseSpaceSurrogate:
    watch = Stopwatch()
    kind = type(settings).__name__
    done, left_out = fitting_runs(f"{kind}.fit", runs)
    used = _by_record(done)
    excitation, dt = common_step(f"{kind}.fit", [some.records[0] for some in used.values()])
    fits: dict[str, RecordFit] = {}
    stages = Stages(progress, dict.fromkeys(used, 1.0))
    for content_hash, some in used.items():
        check_enough(f"{kind}.fit", len(some), f"{len(some)} runs on '{some.records[0].name}'")
        fits[content_hash] = _fit_record(some, regression, settings.left_out_energy, stages.of(content_hash))
        stages.done(content_hash)
    fit = Fit(
        kind, asdict(settings), done.design.space, done.channels, excitation, dt,
        *fitted_range(done.design), len(done), left_out,
        float(np.mean([f.error for f in fits.values()])), settings.limit, settings.outside, watch.seconds, run_digests(done),
    )  # fmt: skip
    return ResponseSpaceSurrogate(fit, fits)


def _by_record(runs: Runs) -> dict[str, Runs]:
    """Runs by the content of their record: one that is there twice is one."""
    hashes = [r.content_hash for r in runs.records]
    of_run = np.array([hashes.index(hashes[i]) for i in runs.record_of_run])
    merged = replace(runs, record_of_run=of_run)
    return {hashes[i]: merged.on(int(i)) for i in np.unique(of_run)}


def _fit_record(runs: Runs, regression: _Regression, left_out_energy: float, progress: Progress) -> RecordFit:
    record = runs.records[0]
    values = runs.values[:, : len(record)]
    scale = values.std(axis=(0, 1))
    if not scale.all():
        still = runs.channels[int(np.argmin(scale))]
        raise InputError(
            "fit", f"the channel '{still}', constant in every run on '{record.name}'", "channels that vary"
        )
    table = (values / scale).reshape(len(values), -1)
    mean, modes, scores, truncation = principal_components(table, left_out_energy)
    predictor = regression(record.content_hash, runs.design, scores, progress)
    deviation = np.sqrt(predictor.leave_one_out_error * scores.var(axis=0))
    return RecordFit(record.name, len(record), mean, modes, truncation, scale, predictor, deviation)


def principal_components(
    table: np.ndarray, left_out_energy: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Proper orthogonal decomposition by the singular value decomposition of the centred table.

    Parameters
    ----------
    table : ndarray, shape (run, sample)
        Histories.
    left_out_energy : float
        Share of the variance that may be left out.

    Returns
    -------
    tuple of ndarray
        Mean (sample,), orthonormal modes (component, sample), scores (run, component), and the standard deviation of what is
        left out (sample,).
    """
    _check_energy(left_out_energy)
    mean = table.mean(axis=0)
    left, singular, right = np.linalg.svd(table - mean, full_matrices=False)
    energy = singular**2
    beyond = energy.sum() - np.cumsum(energy)
    # Components below rounding say nothing.
    kept = 1 + int(np.count_nonzero(beyond > max(left_out_energy, 1e-14) * energy.sum()))
    kept = min(kept, len(table) - 2)
    rest = (left[:, kept:] * singular[kept:]) @ right[kept:]
    return mean, right[:kept], left[:, :kept] * singular[:kept], np.sqrt(np.mean(rest**2, axis=0))


class _Reduction(NamedTuple):
    """Measured channels in the space of the scores, a row each: r = beyond − (c − nearest) Φ.

    Parameters
    ----------
    inner : ndarray, shape (channel, component, component)
        ΦΦᵀ.
    nearest : ndarray, shape (channel, component)
        Scores nearest to the measurement.
    squares_beyond, levers_beyond : ndarray, shape (channel,) and (channel, component)
        ‖beyond‖², and Φ beyond, which is zero but for rounding.
    left_out : ndarray, shape (channel,)
        Variance that the components leave out, averaged over time.
    samples : int
        Length of the measurement.
    """

    inner: Any
    nearest: Any
    squares_beyond: Any
    levers_beyond: Any
    left_out: Any
    samples: Any

    def squares(self, scores: Any) -> Any:
        """‖r‖², shape (channel, run)."""
        gap = scores - self.nearest[:, None]
        return self.squares_beyond[:, None] + ((gap @ self.inner - 2.0 * self.levers_beyond[:, None]) * gap).sum(axis=2)

    def projected(self, scores: Any) -> Any:
        """Φ r, shape (channel, run, component)."""
        return self.levers_beyond[:, None] - (scores - self.nearest[:, None]) @ self.inner


class ResponseSpaceSurrogate(Surrogate):
    """A fitted `PODKriging` or `PODPCE`: knows the response to the records it was fitted to, and to no other.

    Parameters
    ----------
    fit : Fit
        How it came about.
    records : mapping of str to RecordFit
        By content hash of the record.
    """

    loops: ClassVar[bool] = False

    def __init__(self, fit: Fit, records: Mapping[str, RecordFit]) -> None:
        super().__init__(fit)
        self.records = dict(records)

    def check_excitation(self, excitation: Excitation) -> None:
        """Refuse a record the surrogate was not fitted to.

        Parameters
        ----------
        excitation : Excitation
            What is to drive it.

        Raises
        ------
        InputError
            If it is another one, by its values.
        """
        if excitation.content_hash not in self.records:
            known = ", ".join(
                f"'{f.name}' ({f.samples} samples at {self.fitted.dt:g} s)" for f in self.records.values()
            )
            raise InputError(
                f"{self.fitted.kind}: record",
                f"'{excitation.name}' ({len(excitation)} samples at {excitation.dt:g} s), which it was not fitted to",
                known,
                "Fit it to runs on that record, or use PCNARX or KrigingNARX, which take any.",
            )

    def compiled_for(self, excitation: Excitation) -> tuple[Any, ...]:
        """Return what a compiled response depends on: the record itself.

        Parameters
        ----------
        excitation : Excitation
            The record.

        Returns
        -------
        tuple
            A dictionary key.
        """
        return (excitation.content_hash, *response_key(excitation))

    def response(self, theta: Any, excitation: Excitation, stages: Any) -> tuple[Any, Any]:
        """Respond inside JAX: scores, then their sum with the modes.

        Parameters
        ----------
        theta : jax.Array, shape (run, parameter)
            Parameters in the order of `free`.
        excitation : Excitation
            One of the fitted records.
        stages : jax.Array
            Not used: the record is known.

        Returns
        -------
        tuple of jax.Array
            Values (time, channel, run), and whether they are finite (run,).
        """
        from structid.device import jnp

        self.check_excitation(excitation)
        fit = self.records[excitation.content_hash]
        factors = np.tile(fit.scale, fit.samples)
        scores = fit.scores.predict(self.held_inside(theta))
        values = jnp.asarray((fit.modes * factors).T) @ scores.T + jnp.asarray(fit.mean * factors)[:, None]
        finite = jnp.isfinite(scores).all(axis=1)
        return values.reshape(fit.samples, len(fit.scale), -1), finite

    def reduction(self, excitation: Excitation, values: np.ndarray, channels: tuple[str, ...]) -> _Reduction:
        """What a misfit needs of a measurement, once the modes have been summed over; see `JaxModel.reduction`.

        Parameters
        ----------
        excitation : Excitation
            One of the fitted records.
        values : ndarray, shape (time, channel)
            The measurement.
        channels : tuple of str
            Its channels.

        Returns
        -------
        tuple of ndarray
            Products of modes and measurement.
        """
        self.check_excitation(excitation)
        fit = self.records[excitation.content_hash]
        shape, found = (fit.samples, len(fit.scale)), []
        for column, channel in enumerate(channels):
            place = self.channels.index(channel)
            modes = fit.modes.reshape(-1, *shape)[:, :, place] * fit.scale[place]
            residual = values[:, column] - fit.mean.reshape(shape)[:, place] * fit.scale[place]
            # What no combination of modes reaches is left apart, so that a small misfit keeps its digits.
            inner = modes @ modes.T
            nearest = np.linalg.pinv(inner, hermitian=True) @ (modes @ residual)
            beyond = residual - nearest @ modes
            left_out = np.mean(fit.truncation.reshape(shape)[:, place] ** 2) * fit.scale[place] ** 2
            found.append((inner, nearest, beyond @ beyond, modes @ beyond, left_out))
        inner, nearest, squares_beyond, levers_beyond, left_out = map(np.array, zip(*found, strict=True))
        return _Reduction(inner, nearest, squares_beyond, levers_beyond, left_out, float(len(values)))

    def squared_misfit(self, theta: Any, excitation: Excitation, reduction: _Reduction) -> tuple[Any, Any]:
        """Sum of squares in the space of the scores: ‖r − Φᵀc‖² = ‖r‖² − 2 cᵀ(Φr) + cᵀ(ΦΦᵀ)c with r = y − ȳ.

        Parameters
        ----------
        theta : jax.Array, shape (run, parameter)
            Parameters in the order of `free`.
        excitation : Excitation
            One of the fitted records.
        reduction : tuple of arrays
            What is needed of the measurement; see `reduction`.

        Returns
        -------
        tuple of jax.Array
            Sums (channel, run) and whether they are finite (run,).
        """
        from structid.device import jnp

        scores = self.records[excitation.content_hash].scores.predict(self.held_inside(theta))
        return reduction.squares(scores), jnp.isfinite(scores).all(axis=1) & self.admitted(theta)

    def marginal_log_likelihood(
        self, theta: Any, excitation: Excitation, reduction: _Reduction, variance: Any
    ) -> tuple[Any, Any] | None:
        """Log density with the scores' errors integrated out, N(y − ŷ; 0, σ²I + Φᵀ S Φ), of a surrogate of one channel.

        Its modes are orthogonal, ΦΦᵀ = a²I, so that the covariance is diagonal in the space of the scores: with the scores'
        variances s² and p = Φr/a it is σ² + a²s² along each mode, and σ² beyond them,

            −½ [(T − K) log 2πσ² + Σ log 2π(σ² + a²s²) + (‖r‖² − ‖p‖²)/σ² + Σ p²/(σ² + a²s²)].

        Parameters
        ----------
        theta : jax.Array, shape (run, parameter)
            Parameters in the order of `free`.
        excitation : Excitation
            One of the fitted records.
        reduction : tuple of arrays
            What is needed of the measurement; see `reduction`.
        variance : jax.Array, shape (channel, run)
            Of the independent errors; the mean variance that the components leave out is added.

        Returns
        -------
        tuple of jax.Array, or None
            Log density and whether it is finite (run,); None for several channels, whose modes are orthogonal only together.
        """
        from structid.device import jnp

        if len(self.channels) > 1:
            return None
        fit = self.records[excitation.content_hash]
        scores, deviation = self._scores_with_deviation(fit, theta)
        beyond = variance[0] + reduction.left_out[0]
        along = beyond[:, None] + (fit.scale[0] * deviation) ** 2
        projected = (reduction.projected(scores)[0] / fit.scale[0]) ** 2
        along_log = jnp.log(2.0 * jnp.pi * along).sum(axis=1)
        determinant = (reduction.samples - scores.shape[1]) * jnp.log(2.0 * jnp.pi * beyond) + along_log
        squares = (reduction.squares(scores)[0] - projected.sum(axis=1)) / beyond + (projected / along).sum(axis=1)
        density = -0.5 * (determinant + squares)
        return density, jnp.isfinite(density) & self.admitted(theta)

    def error_variance(self, theta: Any, excitation: Excitation, values: Any) -> Any:
        """Variance of the surrogate's error, averaged over time; see `JaxModel.error_variance`.

        Parameters
        ----------
        theta : jax.Array, shape (run, parameter)
            Parameters in the order of `free`.
        excitation : Excitation
            One of the fitted records.
        values : jax.Array, shape (time, channel, run)
            The response there.

        Returns
        -------
        jax.Array, shape (channel, run)
            Of the scores, and of what the components leave out.
        """
        fit = self.records[excitation.content_hash]
        shape = (fit.samples, len(fit.scale))
        squares = (fit.modes.reshape(-1, *shape) ** 2).mean(axis=1) * fit.scale**2
        rest = (fit.truncation.reshape(shape) ** 2).mean(axis=0) * fit.scale**2
        return (self._scores_with_deviation(fit, theta)[1] ** 2 @ squares + rest).T

    def _scores_with_deviation(self, fit: RecordFit, theta: Any) -> tuple[Any, Any]:
        """Scores and their standard deviations, (run, component), inside JAX."""
        from structid.device import jnp

        inside = self.held_inside(theta)
        if isinstance(fit.scores, KrigingPredictor):
            scores, deviation = fit.scores.predict(inside, return_std=True)
            return scores, deviation
        scores = fit.scores.predict(inside)
        return scores, jnp.broadcast_to(jnp.asarray(fit.score_deviation), scores.shape)

    def standard_deviation(self, theta: np.ndarray, excitation: Excitation, values: np.ndarray) -> np.ndarray:
        """Standard deviation in time: that of the scores through the modes, and what the components leave out.

        Parameters
        ----------
        theta : ndarray, shape (run, parameter)
            Points in SI.
        excitation : Excitation
            One of the fitted records.
        values : ndarray, shape (run, time, channel)
            The predictions there.

        Returns
        -------
        ndarray, shape (run, time, channel)
            In SI.
        """
        self.check_excitation(excitation)
        fit = self.records[excitation.content_hash]
        if isinstance(fit.scores, KrigingPredictor):
            deviation = fit.scores.predict(self.held_inside(np.asarray(theta, dtype=np.float64)), return_std=True)[1]
        else:
            deviation = np.tile(fit.score_deviation, (len(theta), 1))
        variance = deviation**2 @ fit.modes**2 + fit.truncation**2
        return np.asarray(np.sqrt(variance).reshape(values.shape) * fit.scale)

    def to_plain(self) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
        """Give what the surrogate consists of, for a file.

        Returns
        -------
        tuple of dict
            What JSON can say, and arrays.
        """
        plain: dict[str, Any] = {}
        arrays: dict[str, np.ndarray] = {}
        for number, (content_hash, fit) in enumerate(self.records.items()):
            scores_plain, scores_arrays = fit.scores.to_plain()
            plain[str(number)] = {
                "hash": content_hash, "name": fit.name, "samples": fit.samples, "scores": scores_plain,
            }  # fmt: skip
            own = {
                "mean": fit.mean, "modes": fit.modes, "truncation": fit.truncation, "scale": fit.scale,
                "score_deviation": fit.score_deviation,
            }  # fmt: skip
            arrays |= put_under(str(number), {**own, **put_under("scores", scores_arrays)})
        return plain, arrays

    @classmethod
    def from_plain(cls, fit: Fit, plain: dict[str, Any], arrays: Mapping[str, np.ndarray]) -> ResponseSpaceSurrogate:
        """Make a surrogate again from what `to_plain` said.

        Parameters
        ----------
        fit : Fit
            How it came about.
        plain : dict
            What JSON can say.
        arrays : mapping of str to ndarray
            The arrays.

        Returns
        -------
        ResponseSpaceSurrogate
            The same surrogate.
        """
        kind = KrigingPredictor if fit.kind == "PODKriging" else ChaosExpansion
        records = {}
        for number, said in plain.items():
            own = found_under(number, arrays)
            scores = found_under("scores", own)
            records[said["hash"]] = RecordFit(
                said["name"], said["samples"], own["mean"], own["modes"], own["truncation"], own["scale"],
                kind.from_plain(fit.space, said["scores"], scores), own["score_deviation"],
            )  # fmt: skip
        return cls(fit, records)
