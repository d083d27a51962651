"""Configuration of JAX: double precision, one device per core, a compilation cache, batches over the devices."""

from __future__ import annotations

import contextlib
import functools
import math
import re
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, PartitionSpec

from structid.core.cores import cache_folder, cores_to_use
from structid.core.freed_memory import return_freed_memory


def _set_up() -> None:
    jax.config.update("jax_enable_x64", True)
    # XLA runs one scan on one core. Each core therefore becomes a separate device, and a batch is divided among the devices.
    # If the caller has already used JAX, its devices remain unchanged.
    with contextlib.suppress(RuntimeError):
        jax.config.update("jax_num_cpu_devices", cores_to_use())
    if jax.config.jax_compilation_cache_dir is None:
        jax.config.update("jax_compilation_cache_dir", str(cache_folder("jax")))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.1)


_set_up()

BatchFunction = Callable[..., Any]

FACTORISATION = re.compile(r"= (cholesky|triangular_solve|lu|geqrf|householder_product|qr|eigh|eig|svd|schur)\b")
"""Regular expression for the operations in a printed jaxpr that call LAPACK."""


@functools.cache
def mesh() -> Mesh:
    """Return a JAX mesh of all devices of the default platform, with one axis named ``runs``."""
    return Mesh(np.array(jax.devices()), ("runs",))


def padded_size(runs: int) -> int:
    """Round up a number of runs, so that few shapes are compiled and the devices share the batch equally."""
    step = (
        2 ** max(math.floor(math.log2(max(runs, 1))) - 3, 0) if runs > 16 else 2 ** math.ceil(math.log2(max(runs, 1)))
    )
    step = math.lcm(step, mesh().size)
    return step * math.ceil(runs / step)


BATCH_SIZES = (16, 64, 256, 512)
"""Batch sizes for a compiled function without a loop over time. Few sizes limit the number of compilations."""


def few_sizes(runs: int) -> int:
    """Round up a number of runs to one of `BATCH_SIZES`, or to a multiple of the largest size."""
    return next((size for size in BATCH_SIZES if runs <= size), -(-runs // BATCH_SIZES[-1]) * BATCH_SIZES[-1])


def over_runs(function: BatchFunction, run_axes: Any = 0, shard: bool = True) -> BatchFunction:
    """Compile a function of arrays with a leading run axis, and divide this axis among the devices."""

    def sharded(theta: Any, constants: tuple[Any, ...]) -> Any:
        if not shard or factorises(theta, constants):
            return function(theta, *constants)
        specs = jax.tree.map(lambda axis: PartitionSpec(*[None] * axis, "runs"), run_axes)
        return jax.shard_map(
            lambda t, c: function(t, *c),
            mesh=mesh(),
            in_specs=(PartitionSpec("runs"), PartitionSpec()),
            out_specs=specs,
            check_vma=False,  # the check would refuse loops of other libraries that start from constants
        )(theta, constants)

    def factorises(theta: Any, constants: tuple[Any, ...]) -> bool:
        return bool(FACTORISATION.search(str(jax.make_jaxpr(function)(theta[:1], *constants))))

    compiled = jax.jit(sharded)
    sizes: set[int] = set()

    def call(theta: Any, *constants: Any) -> Any:
        theta = np.asarray(theta, dtype=np.float64)
        count = len(theta)
        missing = (padded_size if shard else few_sizes)(count) - count
        if missing:
            theta = np.concatenate([theta, np.repeat(theta[-1:], missing, axis=0)])
        result = compiled(theta, constants)
        if len(theta) not in sizes:
            sizes.add(len(theta))
            return_freed_memory()
        axes = jax.tree.map(lambda _: run_axes, result) if isinstance(run_axes, int) else run_axes
        return jax.tree.map(lambda leaf, axis: _gathered(leaf, axis, count), result, axes)

    return call


def _gathered(leaf: jax.Array, axis: int, count: int) -> np.ndarray:
    """Join the parts of an array from all devices; each part is copied by a thread."""
    if leaf.size < 100_000 or axis != leaf.ndim - 1:
        # Copy the array, because the buffer of a JAX array is read-only.
        return np.take(np.array(leaf), np.arange(count), axis)
    whole = np.empty(leaf.shape)

    def copy(shard: Any) -> None:
        whole[shard.index] = np.asarray(shard.data)

    with ThreadPoolExecutor(len(leaf.addressable_shards)) as pool:
        list(pool.map(copy, leaf.addressable_shards))
    return whole[..., :count]


__all__ = ["BATCH_SIZES", "few_sizes", "jnp", "mesh", "over_runs", "padded_size"]
