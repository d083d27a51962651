"""Structure of a NARX: terms of each output, memories, and scales of all signals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from structid.core.channels import base_channel
from structid.core.errors import InputError
from structid.surrogates.narx.structure.candidate_terms import displacement_driven_terms, hysteretic_terms
from structid.surrogates.narx.structure.experiments import Experiments, NARXSignals
from structid.surrogates.narx.structure.recursion import Recursion
from structid.surrogates.narx.structure.terms import Memory, Term, as_memories, as_terms, check_signals


def default_structure(signals: NARXSignals) -> tuple[tuple[tuple[Term, ...], ...], tuple[Memory, ...]]:
    """Return terms with a hysteretic memory for every output; the terms of one output use the past of all outputs.

    Velocities are integrated once and accelerations twice, so that a displacement drives the memory. If the excitation is an
    imposed displacement, it drives the memory.
    """
    if signals.kind == "displacement":
        terms, memories = displacement_driven_terms(signals.outputs, signals.inputs)
    else:
        orders = [_integrations(c) for c in signals.channels]
        terms, memories = hysteretic_terms(signals.outputs, signals.inputs, orders)
    return (terms,) * len(signals.channels), memories


def _integrations(channel: str) -> int:
    """Return the number of integrations that convert a channel to a displacement, by its name."""
    name = base_channel(channel)
    return 2 if "accel" in name else 1 if "veloc" in name else 0


def structure_of(
    given: Sequence[Term | str] | Mapping[str, Sequence[Term | str]] | None,
    memories: Sequence[Memory | str],
    signals: NARXSignals,
) -> tuple[tuple[tuple[Term, ...], ...], tuple[Memory, ...]]:
    """Return the given or default terms of each output, and the memories."""
    if given is None:
        if memories:
            raise InputError(
                "memories", ", ".join(map(str, memories)), "no memories without terms", "Give the terms that use them."
            )
        return default_structure(signals)
    channels = signals.channels
    if isinstance(given, Mapping):
        wrong = [c for c in given if c not in channels] or [c for c in channels if c not in given]
        if wrong:
            raise InputError(
                "terms",
                f"terms for the channels {', '.join(given)}",
                f"terms for each of the channels {', '.join(channels)}",
            )
    of_outputs = tuple(as_terms(given[c] if isinstance(given, Mapping) else given) for c in channels)
    held = as_memories(memories)
    for terms in of_outputs:
        check_signals(terms, held, signals.inputs, signals.outputs)
        if not terms:
            raise InputError("terms", "no terms", "one or more terms")
    return of_outputs, held


def build_recursion(
    experiments: Experiments,
    terms: Sequence[Term | str] | Mapping[str, Sequence[Term | str]] | None,
    memories: Sequence[Memory | str],
) -> Recursion:
    """Combine a structure with the scales of its signals."""
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
            # A hysteresis has the magnitude of its source; only this magnitude affects memories derived from it.
            signals[memory.name] = signals[memory.of] / scales[memory.of]
            scales[memory.name] = 1.0
    initial = experiments.y[:, 0].mean(axis=0) / np.array([scales[y] for y in outputs])
    return Recursion(of_outputs, held, inputs, outputs, experiments.dt, scales, initial)


def _scale(signal: np.ndarray, counted: np.ndarray) -> float:
    """Return the standard deviation of a signal, or one if the signal is constant."""
    deviation = float(signal[counted].std())
    return deviation if deviation > 0 else 1.0
