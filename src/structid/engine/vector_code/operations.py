"""A traced JAX function as a flat list of operations."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from jax.extend.core import ClosedJaxpr, Literal
from jax.lax import slice_p, squeeze_p

CALLS = {"jit": "jaxpr", "pjit": "jaxpr", "closed_call": "call_jaxpr", "custom_jvp_call": "call_jaxpr"}
"""Primitives that call a function, and for each the name of the parameter that contains the function."""


@dataclass(frozen=True, eq=False)
class Result:
    """Result of an operation."""

    aval: Any  # shape and type


@dataclass(frozen=True)
class Operation:
    """A primitive operation, as an equation of a jaxpr."""

    primitive: Any  # the primitive
    params: dict[str, Any]  # parameters of the primitive
    invars: tuple[Any, ...]  # operands
    outvars: tuple[Any, ...]  # results


@dataclass(frozen=True)
class Function:
    """A traced function in which all calls of other functions are inlined; loop bodies stay separate."""

    invars: Sequence[Any]  # arguments
    outvars: Sequence[Any]  # results
    constvars: Sequence[Any]  # variables of the constants
    consts: Sequence[Any]  # values of the constants
    eqns: Sequence[Operation]  # the operations

    @classmethod
    def inlined(cls, traced: ClosedJaxpr) -> Function:
        """Inline the functions that a traced function calls."""
        body = traced.jaxpr
        variables = {v: v for v in (*body.constvars, *body.invars)}
        constants: dict[Any, Any] = dict(zip(body.constvars, traced.consts, strict=True))
        operations: list[Operation] = []
        outvars = _written_out(body, variables, constants, operations)
        return cls(body.invars, outvars, list(constants), list(constants.values()), operations)

    def given(self, value: Any) -> Function:
        """Return a copy in which the last argument is a constant with this value."""
        *arguments, last = self.invars
        return replace(self, invars=arguments, constvars=[*self.constvars, last], consts=[*self.consts, value])


def _written_out(body: Any, known: dict[Any, Any], constants: dict[Any, Any], operations: list[Operation]) -> list[Any]:
    """Append the operations of a function body and return its results; `known` maps its variables to values."""

    def read(atom: Any) -> Any:
        return atom if isinstance(atom, Literal) else known[atom]

    for equation in body.eqns:
        operands = tuple(read(atom) for atom in equation.invars)
        name = equation.primitive.name
        if name == "unstack":  # this primitive splits an array in JAX 0.12
            results = _taken_apart(operands[0], equation.params["axis"], operations)
        elif name not in CALLS:
            results = tuple(Result(v.aval) for v in equation.outvars)
            operations.append(Operation(equation.primitive, equation.params, operands, results))
        else:
            called = equation.params[CALLS[name]]
            locals_of_call = {v: Result(v.aval) for v in called.jaxpr.constvars}
            constants.update(zip(locals_of_call.values(), called.consts, strict=True))
            inside = locals_of_call | dict(zip(called.jaxpr.invars, operands, strict=True))
            results = tuple(_written_out(called.jaxpr, inside, constants, operations))
        known.update(zip(equation.outvars, results, strict=True))
    return [read(atom) for atom in body.outvars]


def _taken_apart(array: Any, axis: int, operations: list[Operation]) -> tuple[Result, ...]:
    """Append operations that split an array along an axis: slices of length one, from which the axis is removed."""
    before, length, after = array.aval.shape[:axis], array.aval.shape[axis], array.aval.shape[axis + 1 :]
    results = []
    for index in range(length):
        first, last = (*(0 for _ in before), index, *(0 for _ in after)), (*before, index + 1, *after)
        part, whole = (Result(array.aval.update(shape=shape)) for shape in ((*before, 1, *after), (*before, *after)))
        where = {"start_indices": first, "limit_indices": last, "strides": None}
        operations.append(Operation(slice_p, where, (array,), (part,)))
        operations.append(Operation(squeeze_p, {"dimensions": (axis,)}, (part,), (whole,)))
        results.append(whole)
    return tuple(results)


def largest_state(function: Function) -> int:
    """Return the largest number of values that a loop of the function computes in each iteration for the next one."""
    loops = [operation.params for operation in function.eqns if operation.primitive.name == "scan"]
    return max((_computed(loop) for loop in loops), default=0)


def _computed(loop: dict[str, Any]) -> int:
    """Count the carried values of a loop without those that it only moves, as in a window of the latest samples."""
    _, carried = constants_and_carried(loop)
    body = loop["jaxpr"].jaxpr
    produced = {variable: operation for operation in body.eqns for variable in operation.outvars}

    def name(atom: Any) -> str:
        operation = None if isinstance(atom, Literal) else produced.get(atom)
        return "" if operation is None else str(operation.primitive.name)

    count = 0
    for variable in body.outvars[:carried]:
        parts = produced[variable].invars if name(variable) == "concatenate" else [variable]
        moved = {"slice"} if len(parts) > 1 else set()
        count += sum(math.prod(part.aval.shape) for part in parts if name(part) not in moved)
    return count


def constants_and_carried(loop: dict[str, Any]) -> tuple[int, int]:
    """Count a loop's constant arrays and its carried arrays."""
    if "num_consts" in loop:
        return loop["num_consts"], loop["num_carry"]
    constants, carried, _ = loop["ft_in"].unpack()  # from JAX 0.11 on
    return len(constants), len(carried)
