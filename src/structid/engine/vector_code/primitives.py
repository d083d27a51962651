"""Vector code of JAX's primitive operations, with tables for arithmetic, rearrangement and reduction.

An array of the function is represented by a NumPy array whose elements are constants or registers.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from structid.engine.vector_code.elementary import exponential, logarithm, logarithm_of_one_plus
from structid.engine.vector_code.registers import Number, Register
from structid.engine.vector_code.vector_code import FLAGS, VectorCode

Array = np.ndarray
Parameters = Mapping[str, Any]


class UntranslatableError(Exception):
    """Error raised for an operation without vector code in a loop over time; JAX then runs the loop."""


# --- arithmetic -----------------------------------------------------------------------------------------------------


def _plain(words: str) -> Callable[..., Number]:
    return lambda code, _, *numbers: code.operation(f"{words} {FLAGS}", numbers)


def _sum(code: VectorCode, _: Parameters, a: Number, b: Number) -> Number:
    for this, other in ((a, b), (b, a)):
        if not isinstance(this, Register) and this == 0.0:
            return other
    return code.operation(f"fadd {FLAGS}", [a, b])


def _product_of_two(code: VectorCode, _: Parameters, a: Number, b: Number) -> Number:
    # Zero times a non-finite number is zero here. A run that diverges is recognised by its state.
    return _times(code, a, b)


def _intrinsic(function: str) -> Callable[..., Number]:
    return lambda code, _, *numbers: code.call(function, numbers)


def _comparison(words: str) -> Callable[..., Number]:
    return lambda code, _, *numbers: code.operation(f"fcmp {words}", numbers, result="i1")


def _logical(words: str) -> Callable[..., Number]:
    return lambda code, _, *numbers: code.operation(words, numbers, kind="i1")


def _negative(code: VectorCode, _: Parameters, x: Number) -> Number:
    return code.operation(f"fneg {FLAGS}", [x])


def _sign(code: VectorCode, _: Parameters, x: Number) -> Number:
    # −1, 0 or 1; NaN for NaN
    one = code.call("copysign", [1.0, x])
    return code.select(code.operation("fcmp one", [x, 0.0], result="i1"), one, x)


def _whole_power(code: VectorCode, parameters: Parameters, x: Number) -> Number:
    return _product(code, x, int(parameters["y"]))


def _product(code: VectorCode, x: Number, times: int) -> Number:
    """Return xⁿ, computed by repeated squaring."""
    if times < 0:
        return code.operation(f"fdiv {FLAGS}", [1.0, _product(code, x, -times)])
    if times == 0:
        return 1.0
    half = _product(code, x, times // 2) if times > 1 else 1.0
    square = code.operation(f"fmul {FLAGS}", [half, half]) if times > 1 else 1.0
    if times % 2 == 0:
        return square
    return x if times == 1 else code.operation(f"fmul {FLAGS}", [square, x])


def _power(code: VectorCode, _: Parameters, x: Number, exponent: Number) -> Number:
    if isinstance(exponent, Register):
        raise UntranslatableError("a power with a variable exponent")
    if float(exponent).is_integer() and abs(exponent) <= 64:
        return _product(code, x, int(exponent))
    # xᵃ = exp(a log x) is 0 for x = 0 and NaN for negative x
    return exponential(code, code.operation(f"fmul {FLAGS}", [logarithm(code, x), exponent]))


def _logistic(code: VectorCode, _: Parameters, x: Number) -> Number:
    # 1/(1 + e⁻ˣ)
    grown = exponential(code, code.operation(f"fneg {FLAGS}", [x]))
    return code.operation(f"fdiv {FLAGS}", [1.0, code.operation(f"fadd {FLAGS}", [grown, 1.0])])


def _smaller_or_larger(words: str) -> Callable[..., Number]:
    def chosen(code: VectorCode, _: Parameters, a: Number, b: Number) -> Number:
        # If either number is NaN, the result is NaN, as in NumPy.
        result = code.select(code.operation(f"fcmp {words}", [a, b], result="i1"), a, b)
        return code.select(code.operation("fcmp uno", [a, a], result="i1"), a, result)

    return chosen


def _select(code: VectorCode, _: Parameters, which: Number, no: Number, yes: Number) -> Number:
    return code.select(which, yes, no, _kind(yes, no))


def _kind(*numbers: Number) -> str:
    registers = [n.kind for n in numbers if isinstance(n, Register)]
    return registers[0] if registers else "i1" if isinstance(numbers[0], (bool, np.bool_)) else "double"


def _finite(code: VectorCode, _: Parameters, x: Number) -> Number:
    return code.operation("fcmp one", [code.call("fabs", [x]), math.inf], result="i1")


def _converted(code: VectorCode, parameters: Parameters, x: Number) -> Number:
    dtype = np.dtype(parameters["new_dtype"])
    if not isinstance(x, Register):
        return dtype.type(x).item()
    if dtype == np.float64:
        return code.cast("uitofp", x, "double") if x.kind == "i1" else x
    if dtype == np.bool_:
        return x if x.kind == "i1" else code.operation("fcmp une", [x, 0.0], result="i1")
    raise UntranslatableError(f"a number converted to {dtype}")


def _bounded(code: VectorCode, parameters: Parameters, low: Number, x: Number, high: Number) -> Number:
    least = _smaller_or_larger("ogt")(code, parameters, x, low)
    return _smaller_or_larger("olt")(code, parameters, least, high)


ARITHMETIC: dict[str, Callable[..., Number]] = {
    "add": _sum,
    "add_any": _sum,
    "sub": _plain("fsub"),
    "mul": _product_of_two,
    "div": _plain("fdiv"),
    "neg": _negative,
    "abs": _intrinsic("fabs"),
    "sqrt": _intrinsic("sqrt"),
    "floor": _intrinsic("floor"),
    "ceil": _intrinsic("ceil"),
    "sin": _intrinsic("sin"),
    "cos": _intrinsic("cos"),
    "tan": _intrinsic("tan"),
    "sign": _sign,
    "square": lambda code, _, x: code.operation(f"fmul {FLAGS}", [x, x]),
    "integer_pow": _whole_power,
    "pow": _power,
    "exp": lambda code, _, x: exponential(code, x),
    "log": lambda code, _, x: logarithm(code, x),
    "log1p": lambda code, _, x: logarithm_of_one_plus(code, x),
    "logistic": _logistic,
    "max": _smaller_or_larger("ogt"),
    "min": _smaller_or_larger("olt"),
    "clamp": _bounded,
    "gt": _comparison("ogt"),
    "ge": _comparison("oge"),
    "lt": _comparison("olt"),
    "le": _comparison("ole"),
    "eq": _comparison("oeq"),
    "ne": _comparison("une"),
    "and": _logical("and"),
    "or": _logical("or"),
    "not": lambda code, _, x: code.operation("xor", [x, True], kind="i1"),
    "select_n": _select,
    "is_finite": _finite,
    "convert_element_type": _converted,
    "stop_gradient": lambda code, _, x: x,
    "copy": lambda code, _, x: x,
}
"""Elementwise primitives: ``function(code, parameters, *numbers)`` on one number of each array."""


# --- rearrangement --------------------------------------------------------------------------------------------------


def _slice(parameters: Parameters, x: Array) -> Array:
    strides = parameters["strides"] or (1,) * x.ndim
    places = zip(parameters["start_indices"], parameters["limit_indices"], strides, strict=True)
    return x[tuple(slice(*index) for index in places)]


def _broadcast(parameters: Parameters, x: Array) -> Array:
    shape, at = parameters["shape"], parameters["broadcast_dimensions"]
    widened = np.ones(len(shape), dtype=int)
    widened[list(at)] = x.shape
    return np.broadcast_to(x.reshape(widened), shape)


def _padded(parameters: Parameters, x: Array, value: Array) -> Array:
    if any(low < 0 or high < 0 or inner for low, high, inner in parameters["padding_config"]):
        raise UntranslatableError("a pad that removes")
    widths = [(low, high) for low, high, _ in parameters["padding_config"]]
    result = np.full([n + low + high for n, (low, high) in zip(x.shape, widths, strict=True)], value[()], dtype=object)
    result[tuple(slice(low, low + n) for n, (low, _) in zip(x.shape, widths, strict=True))] = x
    return result


ARRANGEMENT: dict[str, Callable[..., Array]] = {
    "slice": _slice,
    "broadcast_in_dim": _broadcast,
    "squeeze": lambda parameters, x: np.squeeze(x, tuple(parameters["dimensions"])),
    "expand_dims": lambda parameters, x: np.expand_dims(x, tuple(parameters["dimensions"])),
    "reshape": lambda parameters, x: x.reshape(parameters["new_sizes"]),
    "transpose": lambda parameters, x: x.transpose(parameters["permutation"]),
    "rev": lambda parameters, x: np.flip(x, parameters["dimensions"]),
    "concatenate": lambda parameters, *parts: np.concatenate(parts, axis=parameters["dimension"]),
    "stack": lambda parameters, *parts: np.stack(parts, axis=parameters["axis"]),
    "pad": _padded,
}
"""Rearranging primitives: ``function(parameters, *arrays)`` on whole arrays."""


# --- sums -----------------------------------------------------------------------------------------------------------


def _total(code: VectorCode, numbers: Sequence[Number]) -> Number:
    """Sum numbers, skipping constant zeros."""
    counting = [n for n in numbers if isinstance(n, Register) or n != 0.0]
    if not counting:
        return 0.0
    return functools.reduce(lambda total, n: code.operation(f"fadd {FLAGS}", [total, n]), counting)


def sum_over(code: VectorCode, parameters: Parameters, x: Array) -> Array:
    """Sum an array over axes."""
    return _reduced(parameters, x, lambda row: _total(code, row))


def _reduced(parameters: Parameters, x: Array, reduce: Callable[[list[Number]], Number]) -> Array:
    axes = tuple(parameters["axes"])
    kept = [n for axis, n in enumerate(x.shape) if axis not in axes]
    rows = np.moveaxis(x, axes, range(-len(axes), 0)).reshape(int(np.prod(kept)), -1)
    result = np.empty(len(rows), dtype=object)
    for index, row in enumerate(rows):
        result[index] = reduce(list(row))
    return result.reshape(kept)


def product_of_matrices(code: VectorCode, parameters: Parameters, a: Array, b: Array) -> Array:
    """Sum products over shared axes, skipping products with a constant zero."""
    (sum_a, sum_b), (batch_a, batch_b) = parameters["dimension_numbers"]
    left = _grouped(a, batch_a, sum_a)
    right = _grouped(b, batch_b, sum_b)
    result = np.empty((left.shape[0], left.shape[1], right.shape[1]), dtype=object)
    for index in np.ndindex(result.shape):
        batch, i, j = index
        result[index] = _total(code, [_times(code, p, q) for p, q in zip(left[batch, i], right[batch, j], strict=True)])
    own_a = [n for axis, n in enumerate(a.shape) if axis not in (*batch_a, *sum_a)]
    own_b = [n for axis, n in enumerate(b.shape) if axis not in (*batch_b, *sum_b)]
    return result.reshape([a.shape[axis] for axis in batch_a] + own_a + own_b)


def _grouped(x: Array, batch: Sequence[int], summed: Sequence[int]) -> Array:
    """Transpose and reshape to (batch, remaining, summed)."""
    remaining = [axis for axis in range(x.ndim) if axis not in (*batch, *summed)]
    size = [int(np.prod([x.shape[axis] for axis in axes])) for axes in (batch, remaining, summed)]
    return x.transpose([*batch, *remaining, *summed]).reshape(size)


def _times(code: VectorCode, a: Number, b: Number) -> Number:
    for this, other in ((a, b), (b, a)):
        if not isinstance(this, Register) and this in (0.0, 1.0):
            return 0.0 if this == 0.0 else other
    return code.operation(f"fmul {FLAGS}", [a, b])


def truth_over(words: str) -> Callable[..., Array]:
    """Return the operation that combines Booleans along axes."""

    def joined(code: VectorCode, parameters: Parameters, x: Array) -> Array:
        return _reduced(
            parameters, x, lambda row: functools.reduce(lambda a, b: code.operation(words, [a, b], "i1"), row)
        )

    return joined


def extreme_over(words: str) -> Callable[..., Array]:
    """Return the operation for the minimum or maximum along axes."""
    chosen = _smaller_or_larger(words)

    def extreme(code: VectorCode, parameters: Parameters, x: Array) -> Array:
        return _reduced(parameters, x, lambda row: functools.reduce(lambda a, b: chosen(code, {}, a, b), row))

    return extreme


REDUCTION: dict[str, Callable[..., Array]] = {
    "reduce_sum": sum_over,
    "reduce_max": extreme_over("ogt"),
    "reduce_min": extreme_over("olt"),
    "reduce_and": truth_over("and"),
    "reduce_or": truth_over("or"),
    "dot_general": product_of_matrices,
}
"""Reducing primitives: ``function(code, parameters, *arrays)`` on whole arrays."""
