"""One place that sets JAX up: double precision, every core of the machine, a compilation cache, batches over the cores."""

from __future__ import annotations

import contextlib
import functools
import math
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, PartitionSpec


def _set_up() -> None:
    jax.config.update("jax_enable_x64", True)
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    # XLA runs one scan on one core, so each core becomes a device of its own and a batch is spread over them.
    # Where the caller has used JAX already, its devices stay as they are.
    with contextlib.suppress(RuntimeError):
        jax.config.update("jax_num_cpu_devices", cores)
    if jax.config.jax_compilation_cache_dir is None:
        cache = os.environ.get("XDG_CACHE_HOME", str(Path.home() / ".cache"))
        jax.config.update("jax_compilation_cache_dir", str(Path(cache) / "structid" / "jax"))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.5)


_set_up()

BatchFunction = Callable[..., Any]


@functools.cache
def mesh() -> Mesh:
    """Every device of the default platform in a row, named ``runs``.

    Returns
    -------
    jax.sharding.Mesh
        A one-dimensional mesh.
    """
    return Mesh(np.array(jax.devices()), ("runs",))


def padded_size(runs: int) -> int:
    """Round a number of runs up, so that few shapes are compiled and the devices share the batch equally.

    Parameters
    ----------
    runs : int
        How many there are.

    Returns
    -------
    int
        The next number that is a multiple of the devices and, beyond 16, of a quarter of the power of two below it:
        16, 20, 24, 28, 32, 40, … for two devices.
    """
    step = (
        2 ** max(math.floor(math.log2(max(runs - 1, 1))) - 2, 0)
        if runs > 16
        else 2 ** math.ceil(math.log2(max(runs, 1)))
    )
    step = math.lcm(step, mesh().size)
    return step * math.ceil(runs / step)


def over_runs(function: BatchFunction) -> BatchFunction:
    """Compile a function of arrays with a leading run axis, and spread that axis over the devices.

    Parameters
    ----------
    function : callable
        ``function(theta, *constants)``: maps ``theta[run, ...]`` to a tree of arrays with leading axis run,
        each run on its own; the constants are the same for all runs.

    Returns
    -------
    callable
        The same function of NumPy arrays, for any number of runs: it pads by repeating the last run.
    """
    spread = PartitionSpec("runs")

    @jax.jit
    def compiled(theta: Any, constants: tuple[Any, ...]) -> Any:
        return jax.shard_map(
            lambda t, c: function(t, *c), mesh=mesh(), in_specs=(spread, PartitionSpec()), out_specs=spread
        )(theta, constants)

    def call(theta: Any, *constants: Any) -> Any:
        theta = np.asarray(theta, dtype=np.float64)
        count = len(theta)
        missing = padded_size(count) - count
        if missing:
            theta = np.concatenate([theta, np.repeat(theta[-1:], missing, axis=0)])
        return jax.tree.map(lambda leaf: np.asarray(leaf)[:count], compiled(theta, constants))

    return call


__all__ = ["jnp", "mesh", "over_runs", "padded_size"]
