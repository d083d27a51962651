"""Residuals at a sensor's own samples, inside a loop over the samples of the record."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import numpy as np

from structid.engine.device import jnp
from structid.engine.time_loop import Fold
from structid.sensor_sampling import LoopSchedule


def at_sensor_samples(
    fold: Fold,
    schedule: LoopSchedule,
    readings: Any,
    compared: Callable[[Any, Any], Any],
    shape: tuple[int, int],
) -> tuple[Fold, Any]:
    """Return a fold over the samples of the record, and its rows, from a fold over the samples of a sensor.

    `compared` maps a response (channel, run) and the readings of one sample to a sample of `fold`. A window holds the latest
    responses; each step computes the sensor's samples for which the window holds all that they need.
    """
    window = schedule.weights.shape[2]
    slots = range(schedule.sample.shape[1])
    on_steps = jax.tree.map(lambda x: x[np.maximum(schedule.sample, 0)], readings)
    rows = on_steps, schedule.weights, (schedule.sample >= 0).astype(float)
    late_readings = jax.tree.map(lambda x: x[schedule.late], readings)

    def interpolated(weights: Any, responses: Any) -> Any:
        if window == 1:
            return responses[0]
        return (weights[:, None, None] * responses).sum(axis=0)

    def step(carried: tuple[Any, Any], sample: tuple[Any, Any]) -> tuple[Any, Any]:
        responses, sums = carried
        response, (readings_of_step, weights, used) = sample
        responses = jnp.concatenate([responses[1:], response[None]])
        for slot in slots:
            row = jax.tree.map(lambda x, slot=slot: x[slot], readings_of_step)
            after = fold.step(sums, compared(interpolated(weights[slot], responses), row))
            sums = jax.tree.map(lambda new, old, slot=slot: jnp.where(used[slot] > 0.0, new, old), after, sums)
        return responses, sums

    def value(carried: tuple[Any, Any]) -> Any:
        responses, sums = carried
        for number, weights in enumerate(schedule.late_weights):
            row = jax.tree.map(lambda x, number=number: x[number], late_readings)
            sums = fold.step(sums, compared(interpolated(weights, responses), row))
        return fold.value(sums)

    return Fold((jnp.zeros((window, *shape)), fold.start), step, value), rows
