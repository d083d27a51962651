"""PC-NARX and Kriging-NARX: recursions whose coefficients are functions of the parameters; they take any record."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import scipy.ndimage

from structid.errors import InputError, Status, check_choice
from structid.ground_motion.excitation import Excitation
from structid.models.base import Progress
from structid.probability.space import Design, ParameterSpace
from structid.runs import InMemory, Runs
from structid.surrogates.base import FEWEST_RUNS, Fit, Stopwatch, Surrogate, common_step, fitted_range, fitting_runs
from structid.surrogates.kriging import Kriging, KrigingPredictor
from structid.surrogates.named_arrays import found_under, put_under
from structid.surrogates.pce import PCE, ChaosExpansion
from structid.surrogates.polynomials import PolynomialBasis, multi_indices
from structid.surrogates.recursion import Recursion
from structid.surrogates.structure import (
    FIRST_SHAPES,
    Experiments,
    build_recursion,
    constant_shapes,
    evenly,
    first_coefficients,
    input_signal,
    per_experiment_solution,
    select_terms,
    training_set,
)
from structid.surrogates.terms import Memory, Term, as_memories, as_terms
from structid.surrogates.training import FreeRun, TrainingSet, robust_loss, train_free_run

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TRAINING_BOUND = 2.0
"""While training, outputs are kept within so many times the largest one seen."""

PREDICTION_BOUND = 10.0
"""A prediction beyond so many times the largest output seen has diverged."""

LOSS_SCALE = 1e-3
"""Errors beyond it count by their logarithm only."""

LAST_STEPS = 4
"""Training steps that see all runs."""

HORIZONS = (16, 128)
"""Samples between restarts in the training that goes before, where free runs of the regression diverge."""

WINDOW = 101
"""Samples of the moving root mean square that the predicted standard deviation is proportional to."""


@dataclass(frozen=True)
class NARXSettings:
    """What PC-NARX and Kriging-NARX have in common.

    Parameters
    ----------
    terms : sequence of Term or str, optional
        Candidate terms of every output; left out, terms with a hysteretic memory.
    memories : sequence of Memory or str
        Memories that `terms` use.
    training : {"joint", "per-experiment"}
        All coefficients at once, on the one-step and then on the free-run error; or as in the thesis: coefficients of each
        experiment by ordinary least squares, which are then interpolated.
    selection : {"lars", "orthogonal"}, optional
        Choose among the terms by their free runs; all are kept when left out.
    most_terms : int, optional
        Most terms the selection keeps.
    degree : int
        Largest degree of the chaos expansions that the coefficients of the joint training are.
    steps : int
        Most steps of the training on the free-run error; 0 leaves it at the regression.
    held_out : float
        Share of the runs that choose when to stop and what the predicted standard deviation is.
    washout : float
        Time at the start of each run that does not count [s], where what went before is not known.
    limit : float
        Largest mean relative error with which it may stand in a posterior.
    outside : {"warn", "refuse", "allow"}
        What to do with parameters beyond the range of the design.
    seed : int
        Seed of the choice of held-out runs.
    """

    terms: Sequence[Term | str] | None = None
    memories: Sequence[Memory | str] = ()
    training: Literal["joint", "per-experiment"] = "joint"
    selection: Literal["lars", "orthogonal"] | None = None
    most_terms: int | None = None
    degree: int = 3
    steps: int = 10
    held_out: float = 0.1
    washout: float = 0.0
    limit: float = 5e-2
    outside: Literal["warn", "refuse", "allow"] = "warn"
    seed: int = 0

    def __post_init__(self) -> None:
        check_choice("training", self.training, ("joint", "per-experiment"))
        if self.selection is not None:
            check_choice("selection", self.selection, ("lars", "orthogonal"))
        if not 0.0 <= self.held_out < 0.5:
            raise InputError("held_out", f"{self.held_out}", "a share, 0 or more and below 0.5")
        for name, least in (("degree", 0), ("steps", 0), ("washout", 0.0), ("most_terms", 1)):
            value = getattr(self, name)
            if value is not None and not (isinstance(value, (int, float)) and value >= least):
                raise InputError(name, f"{value!r}", f"a number, {least} or more")
        as_terms(self.terms or ())  # a term or a memory that cannot be read is refused here, not after the runs
        as_memories(self.memories)


@dataclass(frozen=True)
class PCNARX(NARXSettings):
    """Settings of a PC-NARX: a NARX whose coefficients are polynomial chaos expansions (thesis eq. 2.55).

    Parameters
    ----------
    pce : PCE
        For ``training="per-experiment"``: how the coefficients are expanded.
    terms, memories, training, selection, most_terms, degree, steps, held_out, washout, limit, outside, seed
        As for `NARXSettings`.
    """

    pce: PCE = field(default_factory=lambda: PCE(degree=tuple(range(1, 7)), hyperbolic_norm=1.0))

    def fit(self, runs: Runs, progress: Progress | None = None) -> ParametricNARX:
        """Fit to runs on one record or several.

        Parameters
        ----------
        runs : Runs
            Of the model it is to stand for; failed ones are left out.
        progress : callable, optional
            Told how many training steps are done.

        Returns
        -------
        ParametricNARX
            A model for these parameters and any record.
        """
        return _Fitting(self, runs, progress).pc_narx(self.pce)


@dataclass(frozen=True)
class KrigingNARX(NARXSettings):
    """Settings of a Kriging-NARX: a NARX whose coefficients are Kriging predictors (thesis eq. 2.72, with σ for its σ²).

    With ``training="joint"`` the coefficients of each run are refined on its own free run, drawn towards those of the joint
    training as far as the run does not determine them; what they differ by is interpolated. Alone, least squares leaves
    collinear coefficients to wander, and no interpolation follows.

    Parameters
    ----------
    kriging : Kriging
        How the coefficients are interpolated.
    refinements : int
        Steps of the refinement.
    terms, memories, training, selection, most_terms, degree, steps, held_out, washout, limit, outside, seed
        As for `NARXSettings`.
    """

    kriging: Kriging = field(default_factory=lambda: Kriging(nugget="estimate", separable=False))
    refinements: int = 2

    def fit(self, runs: Runs, progress: Progress | None = None) -> ParametricNARX:
        """Fit to runs on one record or several; see `PCNARX.fit`.

        Parameters
        ----------
        runs : Runs
            Of the model it is to stand for; failed ones are left out.
        progress : callable, optional
            Told how many training steps are done.

        Returns
        -------
        ParametricNARX
            A model for these parameters and any record.
        """
        return _Fitting(self, runs, progress).kriging_narx(self.kriging, self.refinements)


@dataclass(frozen=True)
class NARX(NARXSettings):
    """Settings of a NARX of one system: constant coefficients, identified from measured inputs and outputs.

    Parameters
    ----------
    terms, memories, training, selection, most_terms, degree, steps, held_out, washout, limit, outside, seed
        As for `NARXSettings`; there are no parameters, so the degree does not matter.
    """

    def fit(
        self,
        excitations: Excitation | Sequence[Excitation],
        responses: np.ndarray | Sequence[np.ndarray],
        channels: Sequence[str] = ("displacement",),
        progress: Progress | None = None,
    ) -> ParametricNARX:
        """Fit to one experiment or several.

        Parameters
        ----------
        excitations : Excitation or sequence of Excitation
            What drove the system.
        responses : array-like or sequence of array-like, shape (time,) or (time, channel)
            What was measured, in SI, one for each excitation.
        channels : sequence of str
            Names of the channels.
        progress : callable, optional
            Told how many training steps are done.

        Returns
        -------
        ParametricNARX
            A model without free parameters; ``simulate(np.zeros((1, 0)), record)`` runs it.
        """
        if isinstance(excitations, Excitation):
            excitations, responses = [excitations], [responses]  # type: ignore[list-item]
        records = tuple(excitations)
        measured = [np.asarray(r, dtype=np.float64) for r in responses]
        if not records or len(records) != len(measured):
            raise InputError("NARX.fit", f"{len(measured)} responses to {len(records)} excitations", "one to each")
        samples = max(map(len, records))
        values = np.full((len(records), samples, len(channels)), np.nan)
        for row, (record, response) in enumerate(zip(records, measured, strict=True)):
            if response.shape not in ((len(record),) * (len(channels) == 1), (len(record), len(channels))):
                raise InputError(
                    "NARX.fit",
                    f"a response of shape {response.shape}",
                    f"({len(record)}, {len(channels)}) as its excitation",
                )
            values[row, : len(record)] = response.reshape(len(record), -1)
        nothing = Design(np.zeros((len(records), 0)), ParameterSpace())
        status = np.full(len(records), Status.DONE)
        runs = Runs(nothing, records, tuple(channels), InMemory(values), status, np.arange(len(records)))
        return _Fitting(self, runs, progress, fewest=1).pc_narx(PCE(degree=0))


class _Fitting:
    """One fit, step by step: data, structure, coefficients, uncertainty."""

    def __init__(
        self, settings: NARXSettings, runs: Runs, progress: Progress | None, fewest: int = FEWEST_RUNS
    ) -> None:
        self.settings, self.progress, self.watch = settings, progress, Stopwatch()
        self.kind = type(settings).__name__
        self.runs, self.left_out = fitting_runs(f"{self.kind}.fit", runs, fewest)
        records = [self.runs.records[i] for i in np.unique(self.runs.record_of_run)]
        self.excitation, self.dt = common_step(f"{self.kind}.fit", records)
        self.experiments = Experiments.of(self.runs, self.dt, settings.washout)
        self.recursion = build_recursion(self.experiments, settings.terms, settings.memories)
        self.data = training_set(self.experiments, self.recursion)
        self.largest = float(np.abs(self.data.y).max())
        self.fitted, self.unseen = self._split()
        if settings.selection is not None:
            full = FreeRun(self.recursion, TRAINING_BOUND * self.largest)
            self.recursion = select_terms(full, self.data[self.fitted], settings.selection, settings.most_terms)
        self.free_run = FreeRun(self.recursion, TRAINING_BOUND * self.largest)

    @property
    def design(self) -> Design:
        return self.runs.design

    def _split(self) -> tuple[np.ndarray, np.ndarray]:
        """Rows to fit to and rows held out."""
        count = round(self.settings.held_out * len(self.runs))
        order = np.random.default_rng(self.settings.seed).permutation(len(self.runs))
        return np.sort(order[count:]), np.sort(order[:count])

    def pc_narx(self, pce: PCE) -> ParametricNARX:
        if self.settings.training == "per-experiment":
            return self._surrogate(self._interpolated(pce))
        return self._surrogate(Coefficients(self._joint()))

    def kriging_narx(self, kriging: Kriging, refinements: int) -> ParametricNARX:
        if self.settings.training == "per-experiment":
            return self._surrogate(self._interpolated(kriging))
        trend = self._joint()
        start = np.asarray(trend.predict(self.design.values[self.fitted]))
        refined = refined_coefficients(self.free_run, start, self.data[self.fitted], refinements)
        return self._surrogate(self._with_deviation(trend, refined - start, kriging))

    def _interpolated(self, regression: PCE | Kriging) -> Coefficients:
        """Coefficients of each experiment by ordinary least squares, interpolated: the published way."""
        data = self.data[self.fitted]
        vector = constant_shapes(self.recursion, FIRST_SHAPES[1])
        equations = self.free_run.regression_equations(np.tile(vector, (len(data), 1)), data)
        found = per_experiment_solution(self.recursion, *equations, vector)
        space = self.design.space
        mean = PolynomialBasis(space, multi_indices(space.dimension, 0))
        trend = self._expansion(mean, found.mean(axis=0)[:, None], np.ones((len(found), 1)))
        return self._with_deviation(trend, found - found.mean(axis=0), regression)

    def _with_deviation(self, trend: ChaosExpansion, deviation: np.ndarray, regression: PCE | Kriging) -> Coefficients:
        """Add an interpolation of what coefficients differ by from a trend, of those that differ at all."""
        varying = np.flatnonzero(np.ptp(deviation, axis=0) > 1e-12)
        if len(varying) == 0:
            return Coefficients(trend)
        scale = deviation[:, varying].std(axis=0)
        return Coefficients(
            trend, regression.fit(self.design[self.fitted], deviation[:, varying] / scale), varying, scale
        )

    def _joint(self) -> ChaosExpansion:
        """Coefficients as chaos expansions trained together."""
        basis = self._basis()
        features = basis.evaluate(self.design.values)
        data, rows = self.data[self.fitted], features[self.fitted]
        held_out = (features[self.unseen], self.data[self.unseen]) if len(self.unseen) else None
        start = first_coefficients(self.free_run, rows, data)
        if self.settings.steps == 0:
            return self._expansion(basis, start, rows)
        loss = robust_loss(self.free_run.errors(rows @ start.T, data), LOSS_SCALE)
        if loss > np.log1p(0.1 / LOSS_SCALE):  # the free runs are lost: begin with short ones
            for horizon in HORIZONS:
                short = FreeRun(self.recursion, TRAINING_BOUND * self.largest, horizon)
                start = train_free_run(short, start, rows, data, None, 4, LOSS_SCALE).coefficients
        # Most steps see part of the runs only: enough to determine every coefficient.
        some = evenly(len(data), max(len(data) // 4, 3 * len(basis)))
        early = self.settings.steps - LAST_STEPS if len(some) < len(data) // 2 else 0
        if early > 0:
            start = self._trained(start, rows[some], data[some], held_out, early, 0)
        last = self.settings.steps - max(early, 0)
        return self._expansion(basis, self._trained(start, rows, data, held_out, last, max(early, 0)), rows)

    def _trained(
        self,
        start: np.ndarray,
        features: np.ndarray,
        data: TrainingSet,
        held_out: tuple[np.ndarray, TrainingSet] | None,
        steps: int,
        before: int,
    ) -> np.ndarray:

        def tell(done: int, _: int) -> None:
            if self.progress is not None:
                self.progress(before + done, self.settings.steps)

        return train_free_run(self.free_run, start, features, data, held_out, steps, LOSS_SCALE, tell).coefficients

    def _basis(self) -> PolynomialBasis:
        space = self.design.space
        degree = self.settings.degree if space.dimension else 0
        basis = PolynomialBasis(space, multi_indices(space.dimension, degree))
        if len(basis) > max(len(self.fitted) // 2, 1):
            raise InputError(
                f"{self.kind}.fit", f"{len(self.fitted)} runs for coefficients of {len(basis)} chaos terms (degree {degree})",
                f"{2 * len(basis)} runs or more", "Lower the degree.",
            )  # fmt: skip
        return basis

    def _expansion(self, basis: PolynomialBasis, coefficients: np.ndarray, features: np.ndarray) -> ChaosExpansion:
        values = features @ coefficients.T
        unknown = np.full(len(coefficients), np.nan)
        degree = int(basis.indices.sum(axis=1).max())
        truncation = ((degree, 1.0),) * len(coefficients)
        return ChaosExpansion(basis, coefficients.T, unknown, truncation, self.design.values[self.fitted], values)

    def _surrogate(self, coefficients: Coefficients) -> ParametricNARX:
        # Runs held out, or all of them where none are.
        rows = self.unseen if len(self.unseen) else self.fitted
        predicted = np.asarray(coefficients.predict(self.design.values[rows]))
        errors = self.free_run.errors(predicted, self.data[rows])
        fit = Fit(
            self.kind, _settings_in_words(self.settings), self.design.space, self.runs.channels, self.excitation, self.dt,
            *fitted_range(self.runs.design), len(self.runs), self.left_out, float(errors.mean()),
            self.settings.limit, self.settings.outside, self.watch.seconds,
        )  # fmt: skip
        surrogate = ParametricNARX(fit, self.recursion, coefficients, self.largest, np.ones(len(self.runs.channels)))
        return replace_spread(surrogate, self.runs[rows])


def refined_coefficients(free_run: FreeRun, start: np.ndarray, data: TrainingSet, steps: int) -> np.ndarray:
    """Coefficients of every run on its own free run, drawn towards given ones: maximum a posteriori, by Gauss–Newton.

    The prior's spread is a tenth of what the given coefficients vary by over the runs; the noise is the error they leave.

    Parameters
    ----------
    free_run : FreeRun
        Compiled runs.
    start : ndarray, shape (run, coefficient)
        Mean of the prior, and where the search starts.
    data : TrainingSet
        The runs.
    steps : int
        Gauss–Newton steps; a run keeps one only if its error falls.

    Returns
    -------
    ndarray, shape (run, coefficient)
        ϑ of every run.
    """
    spread = 0.1 * np.maximum(start.std(axis=0), 1e-3 * np.abs(start).max(axis=0) + 1e-9)
    current = start
    errors = free_run.errors(current, data).mean(axis=1)
    noise = max(float(np.median(errors)), 1e-12) / data.y.shape[1]
    for _ in range(steps):
        square, inner = free_run.normal_equations(current, data)
        square, inner = square.mean(axis=1) / noise, inner.mean(axis=1) / noise
        # In units of the prior's spread the prior is the identity, and nothing is ill-conditioned.
        matrix = square * spread[:, None] * spread + np.eye(len(spread))
        right = inner * spread - (current - start) / spread
        trial = current + np.linalg.solve(matrix, right[:, :, None])[:, :, 0] * spread
        found = free_run.errors(trial, data).mean(axis=1)
        better = found < errors
        current = np.where(better[:, None], trial, current)
        errors = np.where(better, found, errors)
    return current


def _settings_in_words(settings: NARXSettings) -> dict[str, Any]:
    said = asdict(replace(settings, terms=None, memories=()))
    said["terms"] = None if settings.terms is None else [str(t) for t in settings.terms]
    said["memories"] = [str(m) for m in settings.memories]
    return said


def replace_spread(surrogate: ParametricNARX, runs: Runs) -> ParametricNARX:
    """Set the predicted standard deviation so that 95 % of the samples of some runs lie within 1.96 of it.

    Parameters
    ----------
    surrogate : ParametricNARX
        With any spread.
    runs : Runs
        Runs it was not fitted to.

    Returns
    -------
    ParametricNARX
        The same, with that spread.
    """
    ratios: list[np.ndarray] = []
    for number in np.unique(runs.record_of_run):
        some = runs.on(int(number))
        record = some.records[0]
        true = some.values[:, : len(record)]
        predicted = surrogate.run(surrogate.parameters(some.design), record).values
        local = local_size(predicted)
        good = np.isfinite(predicted).all(axis=(1, 2))
        ratios.append((np.abs(true - predicted) / local)[good].reshape(-1, true.shape[2]))
    every = np.concatenate(ratios)
    spread = np.quantile(every, 0.95, axis=0) / 1.96 if len(every) else np.full(len(surrogate.channels), np.inf)
    return ParametricNARX(surrogate.fitted, surrogate.recursion, surrogate.coefficients, surrogate.largest, spread)


def local_size(values: np.ndarray) -> np.ndarray:
    """Moving root mean square of histories, never below a thousandth of the whole one.

    Parameters
    ----------
    values : ndarray, shape (run, time, channel)
        Histories.

    Returns
    -------
    ndarray, shape (run, time, channel)
        The size.
    """
    window = min(WINDOW, values.shape[1])
    square = scipy.ndimage.uniform_filter1d(values**2, window, axis=1, mode="nearest")
    whole = np.mean(values**2, axis=1, keepdims=True)
    return np.sqrt(np.maximum(square, 1e-6 * whole) + 1e-300)


@dataclass(frozen=True, eq=False)
class Coefficients:
    """Coefficients of the recursion as functions of the parameters: a trend, and what Kriging adds to some of them.

    Parameters
    ----------
    trend : ChaosExpansion
        All coefficients.
    deviation : ChaosExpansion or KrigingPredictor, optional
        Scaled deviations from the trend.
    varying : ndarray of int, optional
        Which coefficients deviate.
    scale : ndarray, optional
        Scale of their deviations.
    """

    trend: ChaosExpansion
    deviation: ChaosExpansion | KrigingPredictor | None = None
    varying: np.ndarray | None = None
    scale: np.ndarray | None = None

    def predict(self, theta: Any) -> Any:
        """Coefficients at points.

        Parameters
        ----------
        theta : ndarray or jax.Array, shape (run, parameter)
            Points in SI.

        Returns
        -------
        array, shape (run, coefficient)
            Of the kind `theta` is.
        """
        from structid.device import jnp

        found = self.trend.predict(theta)
        if self.deviation is None or self.varying is None:
            return found
        added = self.deviation.predict(theta) * self.scale
        if isinstance(found, np.ndarray):
            found = found.copy()
            found[:, self.varying] += added
            return found
        return jnp.asarray(found).at[:, self.varying].add(added)

    def to_plain(self) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
        """Give what they consist of, for a file.

        Returns
        -------
        tuple of dict
            What JSON can say, and arrays.
        """
        plain, arrays = self.trend.to_plain()
        said: dict[str, Any] = {"trend": plain}
        found = put_under("trend", arrays)
        if self.deviation is not None and self.varying is not None and self.scale is not None:
            plain, arrays = self.deviation.to_plain()
            said["deviation"] = [type(self.deviation).__name__, plain]
            found |= put_under("deviation", arrays)
            found |= {"varying": self.varying, "scale": self.scale}
        return said, found

    @classmethod
    def from_plain(cls, space: Any, plain: dict[str, Any], arrays: Mapping[str, np.ndarray]) -> Coefficients:
        """Make them again from what `to_plain` said.

        Parameters
        ----------
        space : ParameterSpace
            The parameters.
        plain : dict
            What JSON can say.
        arrays : mapping of str to ndarray
            The arrays.

        Returns
        -------
        Coefficients
            The same.
        """
        trend = ChaosExpansion.from_plain(space, plain["trend"], found_under("trend", arrays))
        if "deviation" not in plain:
            return cls(trend)
        kind, said = plain["deviation"]
        maker = ChaosExpansion if kind == "ChaosExpansion" else KrigingPredictor
        deviation = maker.from_plain(space, said, found_under("deviation", arrays))
        return cls(trend, deviation, arrays["varying"], arrays["scale"])


class ParametricNARX(Surrogate):
    """A fitted `PCNARX` or `KrigingNARX`: simulates by recursion, for any record of the step it was trained with.

    Parameters
    ----------
    fit : Fit
        How it came about.
    recursion : Recursion
        The structure.
    coefficients : Coefficients
        As functions of the parameters.
    largest : float
        Largest scaled output seen.
    spread : ndarray, shape (channel,)
        Standard deviation of the error relative to the moving root mean square of the prediction.
    """

    def __init__(
        self, fit: Fit, recursion: Recursion, coefficients: Coefficients, largest: float, spread: np.ndarray
    ) -> None:
        super().__init__(fit)
        self.recursion, self.coefficients, self.largest, self.spread = recursion, coefficients, largest, spread

    @property
    def terms(self) -> tuple[str, ...]:
        """What each coefficient belongs to."""
        return self.recursion.names

    def check_excitation(self, excitation: Excitation) -> None:
        """Refuse an excitation of another kind or step.

        Parameters
        ----------
        excitation : Excitation
            What is to drive it.

        Raises
        ------
        InputError
            If a recursion in steps of the training's means nothing for it.
        """
        if excitation.kind != self.fitted.excitation or abs(excitation.dt / self.fitted.dt - 1.0) > 1e-9:
            raise InputError(
                f"{self.fitted.kind}: record",
                f"'{excitation.name}', a {excitation.kind} in steps of {excitation.dt:g} s",
                f"a {self.fitted.excitation} in steps of {self.fitted.dt:g} s, as it was trained with",
                "Resample it.",
            )

    def response(self, theta: Any, excitation: Excitation, stages: Any) -> tuple[Any, Any]:
        """Respond inside JAX by the free run of the recursion.

        Parameters
        ----------
        theta : jax.Array, shape (run, parameter)
            Parameters in the order of `free`.
        excitation : Excitation
            Its kind, step and lead-in.
        stages : jax.Array, shape (time − 1, 1, 3)
            Its values.

        Returns
        -------
        tuple of jax.Array
            Values (time, channel, run), NaN from where a run has diverged, and whether none has (run,).
        """
        from structid.device import jnp

        self.check_excitation(excitation)
        scales = self.recursion.scales
        x = input_signal(excitation, stages)[:, None] / scales["x"]
        bound = PREDICTION_BOUND * self.largest
        coefficients = self.coefficients.predict(self.held_inside(theta)).T
        scaled = self.recursion.free_run(coefficients, x, bound)[excitation.dropped_samples :]
        inside = (jnp.abs(scaled) < bound).all(axis=1)  # [time, run]; NaN is not
        finite = inside.all(axis=0)
        usable = finite & self.admitted(theta)
        factors = np.array([scales[y] for y in self.recursion.outputs])
        alive = jnp.where(finite, True, jnp.cumsum(~inside, axis=0) == 0)
        return jnp.where(alive[:, None], scaled, jnp.nan) * factors[:, None], usable

    def standard_deviation(self, theta: np.ndarray, excitation: Excitation, values: np.ndarray) -> np.ndarray:
        """Standard deviation of the error: a share of the prediction's moving root mean square, from runs held out.

        Parameters
        ----------
        theta : ndarray, shape (run, parameter)
            Points in SI.
        excitation : Excitation
            What drives it.
        values : ndarray, shape (run, time, channel)
            The predictions there.

        Returns
        -------
        ndarray, shape (run, time, channel)
            In SI.
        """
        return local_size(values) * self.spread

    def plot_coefficients(self, runs: Runs, save: str | os.PathLike[str] | None = None) -> Figure:
        """Draw the coefficients against those that runs would have by themselves, as far as they determine them.

        Parameters
        ----------
        runs : Runs
            Runs of the model, best ones the surrogate has not seen.
        save : path-like, optional
            Where to save it, without ending: PNG and PDF are written.

        Returns
        -------
        matplotlib.figure.Figure
            A panel a coefficient.
        """
        from structid.figures import surrogate as figures

        done = runs[runs.done]
        for number in np.unique(done.record_of_run):
            self.check_excitation(done.records[number])
        if done.channels != self.channels:
            raise InputError("plot_coefficients", f"runs of {', '.join(done.channels)}", ", ".join(self.channels))
        data = training_set(Experiments.of(done, self.fitted.dt), self.recursion)
        predicted = np.asarray(self.coefficients.predict(self.held_inside(self.parameters(done.design))))
        own = refined_coefficients(FreeRun(self.recursion, TRAINING_BOUND * self.largest), predicted, data, 2)
        return figures.coefficients(own, predicted, self.terms, save=save)

    def to_plain(self) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
        """Give what the surrogate consists of, for a file.

        Returns
        -------
        tuple of dict
            What JSON can say, and arrays.
        """
        said, arrays = self.coefficients.to_plain()
        recursion = self.recursion
        plain = {
            "terms": [[t.text for t in of] for of in recursion.terms],
            "memories": [str(m) for m in recursion.memories],
            "inputs": list(recursion.inputs),
            "outputs": list(recursion.outputs),
            "scales": dict(recursion.scales),
            "largest": self.largest,
            "coefficients": said,
        }
        return plain, {**arrays, "initial": recursion.initial, "spread": self.spread}

    @classmethod
    def from_plain(cls, fit: Fit, plain: dict[str, Any], arrays: Mapping[str, np.ndarray]) -> ParametricNARX:
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
        ParametricNARX
            The same surrogate.
        """
        recursion = Recursion(
            tuple(tuple(Term(t) for t in of) for of in plain["terms"]),
            tuple(Memory.parse(m) for m in plain["memories"]),
            tuple(plain["inputs"]),
            tuple(plain["outputs"]),
            fit.dt,
            plain["scales"],
            arrays["initial"],
        )
        coefficients = Coefficients.from_plain(fit.space, plain["coefficients"], arrays)
        return cls(fit, recursion, coefficients, plain["largest"], arrays["spread"])
