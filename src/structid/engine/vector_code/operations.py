"""A function that JAX has traced, as a plain list of operations."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from jax.extend.core import ClosedJaxpr, Literal
from jax.lax import slice_p, squeeze_p

CALLS = {"jit": "jaxpr", "pjit": "jaxpr", "closed_call": "call_jaxpr", "custom_jvp_call": "call_jaxpr"}
"""Primitives that stand for a function, and the parameter that holds it."""


@dataclass(frozen=True, eq=False)
class Result:
    """Something that an operation makes."""

    aval: Any  # Its shape and kind


@dataclass(frozen=True)
class Operation:
    """A primitive operation, as an equation of a jaxpr says it."""

    primitive: Any  # Which
    params: dict[str, Any]  # What else it needs to know
    invars: tuple[Any, ...]  # What it takes, and what it makes
    outvars: tuple[Any, ...]  # What it takes, and what it makes


@dataclass(frozen=True)
class Function:
    """A function whose calls of others are written out: operations only. What a loop does in each pass stays as it is."""

    invars: Sequence[Any]  # What it takes and returns
    outvars: Sequence[Any]  # What it takes and returns
    constvars: Sequence[Any]  # Constants, and what they are
    consts: Sequence[Any]  # Constants, and what they are
    eqns: Sequence[Operation]  # The operations

    @classmethod
    def inlined(cls, traced: ClosedJaxpr) -> Function:
        """Write the functions that a function calls in the places where it calls them."""
        body = traced.jaxpr
        known = {v: v for v in (*body.constvars, *body.invars)}
        constants: dict[Any, Any] = dict(zip(body.constvars, traced.consts, strict=True))
        operations: list[Operation] = []
        outvars = _written_out(body, known, constants, operations)
        return cls(body.invars, outvars, list(constants), list(constants.values()), operations)

    def given(self, value: Any) -> Function:
        """Make what it takes last a constant."""
        *taken, last = self.invars
        return replace(self, invars=taken, constvars=[*self.constvars, last], consts=[*self.consts, value])


def _written_out(body: Any, known: dict[Any, Any], constants: dict[Any, Any], operations: list[Operation]) -> list[Any]:
    """Append the operations of a function's body; `known` says what its variables are. Its results are returned."""

    def read(atom: Any) -> Any:
        return atom if isinstance(atom, Literal) else known[atom]

    for equation in body.eqns:
        taken = tuple(read(atom) for atom in equation.invars)
        name = equation.primitive.name
        if name == "unstack":  # what takes an array apart in JAX 0.12
            made = _taken_apart(taken[0], equation.params["axis"], operations)
        elif name not in CALLS:
            made = tuple(Result(v.aval) for v in equation.outvars)
            operations.append(Operation(equation.primitive, equation.params, taken, made))
        else:
            called = equation.params[CALLS[name]]
            own = {v: Result(v.aval) for v in called.jaxpr.constvars}
            constants.update(zip(own.values(), called.consts, strict=True))
            inside = own | dict(zip(called.jaxpr.invars, taken, strict=True))
            made = tuple(_written_out(called.jaxpr, inside, constants, operations))
        known.update(zip(equation.outvars, made, strict=True))
    return [read(atom) for atom in body.outvars]


def _taken_apart(array: Any, axis: int, operations: list[Operation]) -> tuple[Result, ...]:
    """Append what makes one array of each place along an axis: a slice of length one, and then without that axis."""
    before, length, after = array.aval.shape[:axis], array.aval.shape[axis], array.aval.shape[axis + 1 :]
    made = []
    for place in range(length):
        first, last = (*(0 for _ in before), place, *(0 for _ in after)), (*before, place + 1, *after)
        part, whole = (Result(array.aval.update(shape=shape)) for shape in ((*before, 1, *after), (*before, *after)))
        where = {"start_indices": first, "limit_indices": last, "strides": None}
        operations.append(Operation(slice_p, where, (array,), (part,)))
        operations.append(Operation(squeeze_p, {"dimensions": (axis,)}, (part,), (whole,)))
        made.append(whole)
    return tuple(made)


def largest_state(function: Function) -> int:
    """Count the numbers that change from pass to pass of the loop in which most do."""
    loops = [operation.params for operation in function.eqns if operation.primitive.name == "scan"]
    return max((sum(math.prod(aval.shape) for aval in _carried(loop)) for loop in loops), default=0)


def _carried(loop: dict[str, Any]) -> list[Any]:
    """Shapes of what a loop carries from pass to pass."""
    _, carried = constants_and_carried(loop)
    return list(loop["jaxpr"].out_avals[:carried])


def constants_and_carried(loop: dict[str, Any]) -> tuple[int, int]:
    """Count the arrays that a loop takes: those that stay as they are, and those that change from pass to pass."""
    if "num_consts" in loop:
        return loop["num_consts"], loop["num_carry"]
    constants, carried, _ = loop["ft_in"].unpack()  # from JAX 0.11 on
    return len(constants), len(carried)
