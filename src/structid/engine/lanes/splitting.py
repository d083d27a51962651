"""Division of a function: JAX first computes operations without vector code, such as eigenvalues."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np
from jax.extend.core import Literal

from structid.core.freed_memory import return_freed_memory
from structid.engine.device import jnp
from structid.engine.matrices.block_sparse import AXES
from structid.engine.vector_code.operations import Function
from structid.engine.vector_code.primitives import ARITHMETIC, ARRANGEMENT, REDUCTION, UntranslatableError
from structid.engine.vector_code.translation import ALONG_HISTORIES
from structid.engine.vector_code.values import MOVES

LARGEST = 256
"""Largest array of one run for which vector code is written element by element; JAX operates on larger arrays."""

AT_ONCE = (8, 16, 32, 64)
"""Allowed numbers of runs in one call of JAX. Few sizes limit the number of compilations. The matrices of more runs
would exceed the processor's caches: 256 walls take 140 MB, and no less time per wall."""


KEPT = 32
"""Number of programs of JAX that are kept for other functions."""


def foreign_results(function: Function) -> list[Any]:
    """Find intermediate results that depend on a run's parameters and have no vector code."""
    of_run: set[Any] = set(function.invars)
    after_loop: set[Any] = set()
    foreign: set[Any] = set()
    signals, loops = set(function.invars[1:]), 0
    for equation in function.eqns:
        operands = [atom for atom in equation.invars if not isinstance(atom, Literal)]
        if not of_run.intersection(operands):
            continue
        of_run.update(equation.outvars)
        if signals.intersection(operands) and equation.primitive.name in MOVES:
            signals.update(equation.outvars)
            continue
        if equation.primitive.name == "scan":
            loops += 1
            after_loop.update(equation.outvars)
            continue
        if after_loop.intersection(operands):
            after_loop.update(equation.outvars)
            name = equation.primitive.name
            if _is_foreign(equation, of_run) and name not in (*MOVES, *ALONG_HISTORIES, "reduce_sum"):
                raise UntranslatableError(f"'{name}' after the loop over time")
        elif _is_foreign(equation, of_run):
            if signals.intersection(operands):
                raise UntranslatableError(f"'{equation.primitive.name}' of signals")
            foreign.update(equation.outvars)
    if not loops:
        raise UntranslatableError("no loop over time")
    return _needed(function, foreign)


def _is_foreign(equation: Any, of_run: set[Any]) -> bool:
    name = equation.primitive.name
    if equation.primitive in AXES or (name == "while" and _has_code(equation)):
        return False
    sizes = [int(np.prod(v.aval.shape)) for v in (*equation.invars, *equation.outvars)]
    if name == "gather":
        return equation.invars[1] in of_run or max(sizes) > LARGEST
    return (name not in ARITHMETIC and name not in ARRANGEMENT and name not in REDUCTION) or max(sizes) > LARGEST


def _has_code(loop: Any) -> bool:
    """Whether every operation of an iterative loop has vector code."""
    translatable = {*ARITHMETIC, *ARRANGEMENT, *REDUCTION, *MOVES, "scan", "while", "gather"}
    inside = [e for part in ("cond_jaxpr", "body_jaxpr") for e in Function.inlined(loop.params[part]).eqns]
    return all(
        e.primitive in AXES or (_has_code(e) if e.primitive.name == "while" else e.primitive.name in translatable)
        for e in inside
    )


def _needed(function: Function, foreign: set[Any]) -> list[Any]:
    """Return those results computed by JAX that are used by operations with vector code."""
    needed = {atom for atom in function.outvars if not isinstance(atom, Literal)}
    for equation in function.eqns:
        if not foreign.intersection(equation.outvars):
            needed.update(atom for atom in equation.invars if not isinstance(atom, Literal))
    return [v for e in function.eqns for v in e.outvars if v in foreign and v in needed]


def by_jax(function: Function, results: Sequence[Any]) -> Callable[[Any], Any]:
    """Return a JAX function that computes intermediate results of a function for many runs."""
    required, steps = set(results), []
    for equation in reversed(function.eqns):
        if required.intersection(equation.outvars):
            steps.append(equation)
            required.update(atom for atom in equation.invars if not isinstance(atom, Literal))
    steps.reverse()

    def of_one_run(theta: Any) -> Any:
        values = dict(zip([*function.constvars, function.invars[0]], [*function.consts, theta[None]], strict=True))
        for equation in steps:
            operands = [atom.val if isinstance(atom, Literal) else values[atom] for atom in equation.invars]
            computed = equation.primitive.bind(*operands, **equation.params)
            values.update(
                zip(equation.outvars, computed if equation.primitive.multiple_results else [computed], strict=True)
            )
        return jnp.concatenate([jnp.ravel(values[v]).astype(float) for v in results])

    of_runs: Callable[[Any], Any] = jax.vmap(of_one_run, out_axes=1)
    return of_runs


def in_few_sizes(function: Callable[[Any], Any]) -> Callable[[np.ndarray], np.ndarray]:
    """Compile a function of many runs for the batch sizes `AT_ONCE` only."""
    programs: dict[int, Callable[[np.ndarray], Any]] = {}

    def of_rows(theta: np.ndarray) -> np.ndarray:
        results, first = np.empty((0, 0)), 0
        while first < len(theta):
            left = len(theta) - first
            size = next((size for size in AT_ONCE if size >= left), AT_ONCE[-1])
            rows = theta[first : first + size]
            padded = np.concatenate([rows, np.repeat(rows[-1:], size - len(rows), axis=0)])
            if size not in programs:
                programs[size] = _program(function, padded.shape)
            part = np.asarray(programs[size](padded))[:, : len(rows)]
            if first == 0:
                results = np.empty((len(part), len(theta)))
            results[:, first : first + size] = part
            first += size
        return results

    return of_rows


def _program(function: Callable[[Any], Any], shape: tuple[int, ...]) -> Callable[[np.ndarray], Any]:
    """Compile a function for one size, or take the same program of another function.

    A wall with other channels has the same program before its loop: 30 MB, and up to three seconds.
    """
    lowered = jax.jit(function).lower(jax.ShapeDtypeStruct(shape, np.float64))
    # The text holds all constants.
    key = hashlib.sha256(lowered.as_text().encode()).digest()
    if key not in _programs:
        if len(_programs) >= KEPT:
            _programs.pop(next(iter(_programs)))
        _programs[key] = lowered.compile()
        return_freed_memory()
    return _programs[key]


_programs: dict[bytes, Callable[[np.ndarray], Any]] = {}
