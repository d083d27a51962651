"""From runs to a NARX structure: signals, scales, training data, first coefficients, and which terms to keep.

"The thesis" is the MSc thesis in docs/bibliography.md.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from structid.channels import base_channel
from structid.errors import InputError
from structid.ground_motion.excitation import Excitation
from structid.models.face import Progress
from structid.runs import Runs
from structid.surrogates.array_module import namespace
from structid.surrogates.chaos.lars import least_angle_order, orthogonal_order
from structid.surrogates.narx.recursion import Recursion
from structid.surrogates.narx.terms import (
    Memory,
    Term,
    as_memories,
    as_terms,
    check_signals,
    displacement_driven_terms,
    hysteretic_terms,
)
from structid.surrogates.narx.training import FreeRun, TrainingSet, joint_solution, robust_loss
from structid.surrogates.progress import Steps

FIRST_SHAPES = (0.1, 0.25, 0.6, 1.5)
"""Values of a hysteresis' shape b that are tried, relative to the size of the signal it remembers; g starts from zero."""

RIDGES = (1e-10, 1e-8, 1e-6, 1e-4)
"""Ridges of the joint regression that are tried."""

TRIED_RUNS = 100
"""Runs the first coefficients are judged by."""

MOST_CANDIDATES = 60
"""Sets of terms that are compared by their free runs at most."""


@dataclass(frozen=True)
class Signals:
    """What the inputs and outputs of a NARX are.

    Parameters
    ----------
    inputs : tuple of str
        Names of the inputs in terms: ``x``, or ``x1``, ``x2``, … of several.
    channels : tuple of str
        Channels of the outputs.
    kind : str
        Of the excitations.
    """

    inputs: tuple[str, ...]
    channels: tuple[str, ...]
    kind: str = ""

    @classmethod
    def of(cls, excitation: Excitation, channels: Sequence[str]) -> Signals:
        """Name the signals of an excitation and a response.

        Parameters
        ----------
        excitation : Excitation
            One of those that drive.
        channels : sequence of str
            Of the response.

        Returns
        -------
        Signals
            Their names.
        """
        count = excitation.values[:1].size
        return cls(_names("x", count), tuple(channels), excitation.kind)

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names of the outputs in terms: ``y``, or ``y1``, ``y2``, … of several."""
        return _names("y", len(self.channels))


def _names(letter: str, count: int) -> tuple[str, ...]:
    return (letter,) if count == 1 else tuple(f"{letter}{i + 1}" for i in range(count))


@dataclass(frozen=True, eq=False)
class Experiments:
    """Runs as a NARX sees them.

    Parameters
    ----------
    x : ndarray, shape (run, time, input)
        Inputs in SI; zero beyond the end of a shorter record.
    y : ndarray, shape (run, time, output)
        Outputs in SI; likewise.
    counted : ndarray of bool, shape (run, time)
        Samples of the record.
    dt : float
        Time step [s].
    signals : Signals
        What they are called.
    """

    x: np.ndarray
    y: np.ndarray
    counted: np.ndarray
    dt: float
    signals: Signals

    @classmethod
    def of(cls, runs: Runs, dt: float, washout: float = 0.0) -> Experiments:
        """Bring runs into arrays.

        Parameters
        ----------
        runs : Runs
            Finished runs, on one record or several.
        dt : float
            Their time step [s].
        washout : float
            Time at the start that does not count [s].

        Returns
        -------
        Experiments
            The arrays.
        """
        used = [runs.records[i] for i in runs.record_of_run]
        samples = max(len(r) + r.dropped_samples for r in used)
        x = np.zeros((len(runs), samples, used[0].values[:1].size))
        y = np.zeros((len(runs), samples, len(runs.channels)))
        counted = np.zeros((len(runs), samples), dtype=bool)
        values = runs.values
        for row, record in enumerate(used):
            # A periodic record's lead-in is not measured, but at its end the response repeats itself as the record does.
            periods = 1 + record.lead_in_periods
            end = periods * len(record)
            x[row, :end] = np.tile(record.values.reshape(len(record), -1), (periods, 1))
            y[row, :end] = np.tile(values[row, : len(record)], (periods, 1))
            counted[row, record.dropped_samples + round(washout / dt) : end] = True
        if not counted.any(axis=1).all():
            raise InputError("washout", f"{washout:g} s", "less than the shortest record")
        return cls(x, y, counted, dt, Signals.of(used[0], runs.channels))


def input_signals(stages: Any) -> Any:
    """Samples of an excitation, its lead-in included, from the stages of an integration with one step a sample.

    Parameters
    ----------
    stages : array, shape (time − 1, 1, 3) or (time − 1, 1, 3, input)
        From `Excitation.stage_values(1)`.

    Returns
    -------
    array, shape (time, input)
        The samples.
    """
    steps = stages.reshape(stages.shape[0], 3, -1)
    return namespace(stages).concatenate([steps[:, 0], steps[-1:, 2]])


def default_structure(signals: Signals) -> tuple[tuple[tuple[Term, ...], ...], tuple[Memory, ...]]:
    """Terms with a hysteretic memory for every output; several outputs see one another's past.

    Velocities are integrated once and accelerations twice, so that the memory is of a displacement; a model that is driven by
    an imposed displacement remembers that.

    Parameters
    ----------
    signals : Signals
        With the kind of the excitation and the channels.

    Returns
    -------
    tuple of tuple
        Terms of each output, and memories.
    """
    if signals.kind == "displacement":
        terms, memories = displacement_driven_terms(signals.outputs, signals.inputs)
    else:
        orders = [_integrations(c) for c in signals.channels]
        terms, memories = hysteretic_terms(signals.outputs, signals.inputs, orders)
    return (terms,) * len(signals.channels), memories


def _integrations(channel: str) -> int:
    """How often a channel is integrated until it is a displacement, by its name."""
    name = base_channel(channel)
    return 2 if "accel" in name else 1 if "veloc" in name else 0


def structure_of(
    given: Sequence[Term | str] | Mapping[str, Sequence[Term | str]] | None,
    memories: Sequence[Memory | str],
    signals: Signals,
) -> tuple[tuple[tuple[Term, ...], ...], tuple[Memory, ...]]:
    """Terms of each output and memories, as given or by default.

    Parameters
    ----------
    given : sequence of Term or str, or mapping of str to such, optional
        Terms of every output, or of each by its channel; the default structure when left out.
    memories : sequence of Memory or str
        Memories, when terms are given.
    signals : Signals
        The signals they may use.

    Returns
    -------
    tuple of tuple
        Terms of each output, and memories.

    Raises
    ------
    InputError
        If an output has no terms, or a term names a signal that is not there.
    """
    if given is None:
        if memories:
            raise InputError(
                "memories", ", ".join(map(str, memories)), "none without terms", "Say which terms use them."
            )
        return default_structure(signals)
    channels = signals.channels
    if isinstance(given, Mapping):
        wrong = [c for c in given if c not in channels] or [c for c in channels if c not in given]
        if wrong:
            raise InputError(
                "terms", f"those of {', '.join(given)}", f"those of {', '.join(channels)}, each by its channel"
            )
    of_outputs = tuple(as_terms(given[c] if isinstance(given, Mapping) else given) for c in channels)
    held = as_memories(memories)
    for terms in of_outputs:
        check_signals(terms, held, signals.inputs, signals.outputs)
        if not terms:
            raise InputError("terms", "none", "one term or more")
    return of_outputs, held


def build_recursion(
    experiments: Experiments,
    terms: Sequence[Term | str] | Mapping[str, Sequence[Term | str]] | None,
    memories: Sequence[Memory | str],
) -> Recursion:
    """Put a structure and the scales of its signals together.

    Parameters
    ----------
    experiments : Experiments
        What the scales are taken from.
    terms : sequence of Term or str, or mapping of str to such, optional
        Terms of every output, or of each by its channel; the default structure when left out.
    memories : sequence of Memory or str
        Memories, when terms are given.

    Returns
    -------
    Recursion
        The structure.
    """
    of_outputs, held = structure_of(terms, memories, experiments.signals)
    inputs, outputs = experiments.signals.inputs, experiments.signals.outputs
    signals = {x: experiments.x[:, :, i] for i, x in enumerate(inputs)}
    signals |= {y: experiments.y[:, :, i] for i, y in enumerate(outputs)}
    scales = {name: _scale(signal, experiments.counted) for name, signal in signals.items()}
    for memory in held:
        if memory.kind == "integral":
            source = signals[memory.of]
            middle = 0.5 * (source[:, 1:] + source[:, :-1]) * experiments.dt
            signals[memory.name] = np.cumsum(np.pad(middle, ((0, 0), (1, 0))), axis=1)
            scales[memory.name] = _scale(signals[memory.name], experiments.counted)
        elif memory.of in signals:
            # Only its size matters to what is made of it, and that is the size of what it remembers.
            signals[memory.name] = signals[memory.of] / scales[memory.of]
            scales[memory.name] = 1.0
    initial = experiments.y[:, 0].mean(axis=0) / np.array([scales[y] for y in outputs])
    return Recursion(of_outputs, held, inputs, outputs, experiments.dt, scales, initial)


def _scale(signal: np.ndarray, counted: np.ndarray) -> float:
    spread = float(signal[counted].std())
    return spread if spread > 0 else 1.0


def training_set(experiments: Experiments, recursion: Recursion) -> TrainingSet:
    """Scale experiments.

    Parameters
    ----------
    experiments : Experiments
        In SI.
    recursion : Recursion
        With the scales.

    Returns
    -------
    TrainingSet
        Scaled.
    """
    x = experiments.x / np.array([recursion.scales[name] for name in recursion.inputs])
    y = experiments.y / np.array([recursion.scales[name] for name in recursion.outputs])
    return TrainingSet(x, y, experiments.counted, np.ones(len(x)))


def first_coefficients(
    runs: FreeRun,
    features: np.ndarray,
    data: TrainingSet,
    ridges: Sequence[float] = RIDGES,
    progress: Progress | None = None,
) -> np.ndarray:
    """Joint one-step regression; the hysteresis' shapes and the ridge by the free run of some of the experiments.

    Parameters
    ----------
    runs : FreeRun
        Compiled runs.
    features : ndarray, shape (run, feature)
        ψ of the experiments.
    data : TrainingSet
        The experiments.
    ridges : sequence of float
        To be tried.
    progress : callable, optional
        Told how many have been tried.

    Returns
    -------
    ndarray, shape (coefficient, feature)
        The best A; the shapes are constant.
    """
    recursion = runs.recursion
    tried = spread_rows(data.weights, TRIED_RUNS)
    best, lowest = np.zeros((recursion.size, features.shape[1])), np.inf
    shapes = FIRST_SHAPES if any(m.shapes for m in recursion.memories) else (0.0,)
    tell = Steps(progress, len(shapes) * len(ridges))
    for shape in shapes:
        vector = constant_shapes(recursion, shape)
        square, inner = runs.regression_equations(np.tile(vector, (len(data), 1)), data)
        square, inner = square.sum(axis=1), inner.sum(axis=1)
        for ridge in ridges:
            found = joint_solution(square, inner, features, data.weights, ridge)
            found[recursion.linear_size :, 0] = vector[recursion.linear_size :]
            loss = robust_loss(runs.errors(features[tried] @ found.T, data[tried]), 1e-3)
            if loss < lowest:
                best, lowest = found, loss
            tell()
    return best


def spread_rows(weights: np.ndarray, most: int) -> np.ndarray:
    """Choose rows spread over all of them, as densely as they weigh.

    Parameters
    ----------
    weights : ndarray, shape (row,)
        How much each row counts.
    most : int
        How many are wanted at most.

    Returns
    -------
    ndarray of int
        Rising; fewer than wanted where few rows weigh all.
    """
    if len(weights) <= most:
        return np.arange(len(weights))
    reached = np.cumsum(weights) / np.sum(weights)
    return np.unique(np.searchsorted(reached, (np.arange(most) + 0.5) / most))


def constant_shapes(recursion: Recursion, shape: float) -> np.ndarray:
    """Coefficient vector with nothing but shapes, b as given and g zero.

    Parameters
    ----------
    recursion : Recursion
        The structure.
    shape : float
        b of every hysteresis.

    Returns
    -------
    ndarray, shape (coefficient,)
        The vector.
    """
    vector = np.zeros(recursion.size)
    vector[recursion.linear_size :: 2] = shape
    return vector


def select_terms(
    runs: FreeRun, data: TrainingSet, method: str, most: int | None, progress: Progress | None = None
) -> Recursion:
    """Choose terms as the thesis does in its first phase, by the free-run error over all experiments (eqs. 2.62 to 2.66).

    Each experiment orders the terms by its own one-step regression and so proposes nested sets; each set that is proposed is
    refitted by ordinary least squares to every experiment, free-run there, and the one with the smallest robust mean error is kept.

    Parameters
    ----------
    runs : FreeRun
        Compiled runs of the full structure.
    data : TrainingSet
        The experiments.
    method : {"lars", "orthogonal"}
        How each experiment orders the terms.
    most : int, optional
        Most terms of an output.
    progress : callable, optional
        Told how many outputs are done.

    Returns
    -------
    Recursion
        The structure with the terms kept.
    """
    recursion = runs.recursion
    some = data[spread_rows(data.weights, TRIED_RUNS)]
    vector = constant_shapes(recursion, FIRST_SHAPES[1])
    square, inner = runs.regression_equations(np.tile(vector, (len(some), 1)), some)
    kept: list[tuple[Term, ...]] = []
    start = 0
    for output, terms in enumerate(recursion.terms):
        own = slice(start, start + len(terms))
        candidates = _proposed(square[:, output, own, own], inner[:, output, own], method, most or len(terms))
        kept.append(_best_candidate(runs, some, output, own, candidates, square, inner, vector))
        start += len(terms)
        if progress is not None:
            progress(output + 1, len(recursion.terms))
    return replace(recursion, terms=tuple(kept))


def _proposed(square: np.ndarray, inner: np.ndarray, method: str, most: int) -> list[tuple[int, ...]]:
    """Sets of terms that experiments propose, those most often proposed first."""
    count: dict[tuple[int, ...], int] = {}
    for gram, covariance in zip(square, inner, strict=True):
        scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
        standard = gram / scale[:, None] / scale
        if method == "lars":
            order = least_angle_order(standard, covariance / scale, 1, min(most, len(scale)))
        else:
            order = orthogonal_order(standard, covariance / scale, min(most, len(scale)))
        for size in range(1, len(order) + 1):
            chosen = tuple(sorted(int(i) for i in order[:size]))
            count[chosen] = count.get(chosen, 0) + 1
    ranked = sorted(count, key=lambda c: (-count[c], len(c), c))
    return ranked[:MOST_CANDIDATES]


def _best_candidate(
    runs: FreeRun,
    data: TrainingSet,
    output: int,
    own: slice,
    candidates: list[tuple[int, ...]],
    square: np.ndarray,
    inner: np.ndarray,
    vector: np.ndarray,
) -> tuple[Term, ...]:
    """Refit every candidate to every experiment, the other outputs with all their terms, and compare free runs."""
    recursion = runs.recursion
    full = per_experiment_solution(recursion, square, inner, vector)
    best, lowest = recursion.terms[output], np.inf
    for chosen in candidates:
        coefficients = full.copy()
        coefficients[:, own] = 0.0
        columns = own.start + np.array(chosen)
        gram = square[:, output][:, columns][:, :, columns]
        coefficients[:, columns] = _solved(gram, inner[:, output][:, columns])
        loss = robust_loss(runs.errors(coefficients, data)[:, [output]], 1e-2)
        if loss < lowest:
            best, lowest = tuple(recursion.terms[output][i] for i in chosen), loss
    return best


def per_experiment_solution(
    recursion: Recursion, square: np.ndarray, inner: np.ndarray, vector: np.ndarray
) -> np.ndarray:
    """Ordinary least squares of every experiment by itself (thesis eq. 2.62).

    Parameters
    ----------
    recursion : Recursion
        The structure.
    square, inner : ndarray
        One-step normal equations of each run and output.
    vector : ndarray, shape (coefficient,)
        The shapes, which are kept.

    Returns
    -------
    ndarray, shape (run, coefficient)
        ϑ of every run.
    """
    found = np.tile(vector, (len(square), 1))
    start = 0
    for output, terms in enumerate(recursion.terms):
        own = slice(start, start + len(terms))
        found[:, own] = _solved(square[:, output, own, own], inner[:, output, own])
        start += len(terms)
    return found


def _solved(gram: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Solve many small normal equations, scaled to a unit diagonal; the ridge is at the level of rounding."""
    scale = np.sqrt(np.maximum(np.einsum("rii->ri", gram), 1e-300))
    standard = gram / scale[:, :, None] / scale[:, None, :] + 1e-12 * np.eye(gram.shape[1])
    return np.linalg.solve(standard, (covariance / scale)[:, :, None])[:, :, 0] / scale
