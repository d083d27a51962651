"""What of a function JAX does first: operations before its loops that have no vector code, such as the modes of a matrix."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np
from jax.extend.core import ClosedJaxpr, Literal

from structid.device import jnp
from structid.mechanics.lanes.primitives import ARITHMETIC, ARRANGEMENT, REDUCTION, UntranslatableError
from structid.mechanics.lanes.translation import CALLS, MOVES

LARGEST = 256
"""Largest array of one run that vector code operates on number by number; products of larger ones are JAX's."""


def inlined(function: ClosedJaxpr) -> ClosedJaxpr:
    """Write the functions that a function calls in the places where it calls them.

    Parameters
    ----------
    function : ClosedJaxpr
        The function.

    Returns
    -------
    ClosedJaxpr
        The same, with operations only. What a loop does in each pass stays as it is.
    """
    return jax.make_jaxpr(lambda *arguments: _evaluated(function, arguments))(*function.in_avals)


def _evaluated(function: ClosedJaxpr, arguments: Sequence[Any]) -> list[Any]:
    body = function.jaxpr
    known = dict(zip([*body.constvars, *body.invars], [*function.consts, *arguments], strict=True))
    for equation in body.eqns:
        taken = [atom.val if isinstance(atom, Literal) else known[atom] for atom in equation.invars]
        inner = CALLS.get(equation.primitive.name)
        if inner:
            made = _evaluated(equation.params[inner], taken)
        else:
            made = equation.primitive.bind(*taken, **equation.params)
            made = made if equation.primitive.multiple_results else [made]
        known.update(zip(equation.outvars, made, strict=True))
    return [atom.val if isinstance(atom, Literal) else known[atom] for atom in body.outvars]


def foreign_results(function: ClosedJaxpr) -> list[Any]:
    """Find results of operations on a run's numbers that have no vector code.

    Parameters
    ----------
    function : ClosedJaxpr
        The function, inlined.

    Returns
    -------
    list of Var
        Those that something with vector code, or the function's result, needs.

    Raises
    ------
    UntranslatableError
        If such an operation comes after a loop over time, or nothing in the function is one.
    """
    of_run, after_loop, foreign = set(function.jaxpr.invars), set(), set()
    signals, loops = set(function.jaxpr.invars[1:]), 0
    for equation in function.jaxpr.eqns:
        taken = [atom for atom in equation.invars if not isinstance(atom, Literal)]
        if not of_run.intersection(taken):
            continue
        of_run.update(equation.outvars)
        if signals.intersection(taken) and equation.primitive.name in MOVES:
            signals.update(equation.outvars)
            continue
        if equation.primitive.name == "scan":
            loops += 1
            after_loop.update(equation.outvars)
            continue
        if after_loop.intersection(taken):
            after_loop.update(equation.outvars)
            if _is_foreign(equation) and equation.primitive.name not in MOVES:
                raise UntranslatableError(f"'{equation.primitive.name}' after the loop over time")
        elif _is_foreign(equation):
            if signals.intersection(taken):
                raise UntranslatableError(f"'{equation.primitive.name}' of signals")
            foreign.update(equation.outvars)
    if not loops:
        raise UntranslatableError("no loop over time")
    return _needed(function, foreign)


def _is_foreign(equation: Any) -> bool:
    name = equation.primitive.name
    sizes = [int(np.prod(v.aval.shape)) for v in (*equation.invars, *equation.outvars)]
    return (name not in ARITHMETIC and name not in ARRANGEMENT and name not in REDUCTION) or max(sizes) > LARGEST


def _needed(function: ClosedJaxpr, foreign: set[Any]) -> list[Any]:
    """Foreign results that others than foreign operations use."""
    needed = {atom for atom in function.jaxpr.outvars if not isinstance(atom, Literal)}
    for equation in function.jaxpr.eqns:
        if not foreign.intersection(equation.outvars):
            needed.update(atom for atom in equation.invars if not isinstance(atom, Literal))
    return [v for e in function.jaxpr.eqns for v in e.outvars if v in foreign and v in needed]


def by_jax(function: ClosedJaxpr, results: Sequence[Any]) -> Callable[[np.ndarray], np.ndarray]:
    """Compile what leads to some results of a function of one run, for many.

    Parameters
    ----------
    function : ClosedJaxpr
        The function of θ, shape (1, parameter), inlined.
    results : sequence of Var
        What is wanted.

    Returns
    -------
    callable
        From θ (run, parameter) to the numbers of all results, shape (number, run).
    """
    wanted, steps = set(results), []
    for equation in reversed(function.jaxpr.eqns):
        if wanted.intersection(equation.outvars):
            steps.append(equation)
            wanted.update(atom for atom in equation.invars if not isinstance(atom, Literal))
    steps.reverse()

    def of_one_run(theta: Any) -> Any:
        body = function.jaxpr
        known = dict(zip([*body.constvars, body.invars[0]], [*function.consts, theta[None]], strict=True))
        for equation in steps:
            taken = [atom.val if isinstance(atom, Literal) else known[atom] for atom in equation.invars]
            made = equation.primitive.bind(*taken, **equation.params)
            known.update(zip(equation.outvars, made if equation.primitive.multiple_results else [made], strict=True))
        return jnp.concatenate([jnp.ravel(known[v]).astype(float) for v in results])

    compiled = jax.jit(jax.vmap(of_one_run, out_axes=1))
    return lambda theta: np.asarray(compiled(theta))
