"""Exponential and logarithm of SIMD vectors; LLVM would call the C library once per lane.

Both functions reduce the argument exactly, sum a series of the small remainder, and assemble the bits of the exponent (e.g.
J.-M. Muller, "Elementary Functions", 3rd ed., ch. 11).
"""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence

from structid.engine.vector_code.registers import Number, Register
from structid.engine.vector_code.vector_code import FLAGS, VectorCode

LOG_2_HIGH = float.fromhex("0x1.62e42fee00000p-1")
LOG_2_LOW = float.fromhex("0x1.a39ef35793c76p-33")
"""log 2 in two parts; the first part has so few digits that its products with integers up to 2048 are exact."""

LARGEST_EXPONENT, SMALLEST_EXPONENT = 710.0, -707.0
"""Limits of the argument of the exponential. Arguments above the first limit are set to it, since at 711 the bits of
2ᵏ⁻¹ would overflow; the exponential is infinite there. Below the second limit, where the exponential is about 1e-307,
the result is zero."""

TO_WHOLE = 1.5 * 2.0**52
"""Constant whose sum with a number of moderate size has the number, rounded to an integer, in its last bits."""

TO_EXPONENT = TO_WHOLE + 1022.0
"""`TO_WHOLE` plus 1022, so that the bits of the rounded number k, shifted to the exponent field, represent 2ᵏ⁻¹."""

SERIES_OF_EXPONENTIAL = (
    1.0,
    1.0,
    0.5000000000000001,
    0.16666666666666669,
    0.041666666666624164,
    0.008333333333330065,
    0.0013888888917196719,
    0.00019841269863040545,
    2.4801521322368692e-05,
    2.7557268480310024e-06,
    2.7620075879983367e-07,
    2.5100375832561234e-08,
)
"""Series of eʳ on |r| ≤ ½ log 2, to 2e-17: 1 + r + r² p(r). p interpolates (eʳ − 1 − r)/r² at ten Chebyshev points."""

MANTISSA, ONE = (1 << 52) - 1, 1023 << 52
"""Mantissa bits of a double, and the bits of 1.0."""

SMALLEST_NORMAL = 2.0**-1022


def exponential(code: VectorCode, x: Number) -> Number:
    """Compute eˣ = 2ᵏ eʳ with |r| ≤ ½ log 2."""
    if not isinstance(x, Register):
        return math.exp(x)
    # A NaN stays NaN: if a comparison is false, the argument itself is used.
    low = code.select(_compare(code, "olt", x, SMALLEST_EXPONENT), SMALLEST_EXPONENT, x)
    held = code.select(_compare(code, "ogt", low, LARGEST_EXPONENT), LARGEST_EXPONENT, low)
    # The difference has no flags, so that LLVM does not cancel the added and subtracted constant.
    shifted = code.call("fmuladd", [held, 1.0 / math.log(2.0), TO_EXPONENT])
    k = code.operation("fsub", [shifted, TO_EXPONENT])
    rest = _multiply_add(code, k, -LOG_2_LOW, _multiply_add(code, k, -LOG_2_HIGH, held))
    # The result is 2 eʳ times 2ᵏ⁻¹, since the bits of 2¹⁰²⁴ would mean infinity.
    twice = _polynomial(code, [2.0 * c for c in SERIES_OF_EXPONENTIAL], rest)
    power_of_two = code.cast("bitcast", code.operation("shl", [_bits(code, shifted), 52], "i64"), "double")
    result = code.operation(f"fmul {FLAGS}", [twice, power_of_two])
    return code.select(_compare(code, "olt", x, SMALLEST_EXPONENT), 0.0, result)


def logarithm(code: VectorCode, x: Number) -> Number:
    """Compute log x = e log 2 + 2 atanh s with x = 2ᵉ m, √½ ≤ m < √2, s = (m − 1)/(m + 1)."""
    if not isinstance(x, Register):
        return math.log(x) if x > 0 else -math.inf if x == 0 else math.nan
    tiny = _compare(code, "olt", x, SMALLEST_NORMAL)
    normal = code.select(tiny, code.operation(f"fmul {FLAGS}", [x, 2.0**54]), x)
    bits = _bits(code, normal)
    # In the mantissa of 2⁵², the bits of the exponent represent a whole number.
    raised = code.operation("or", [code.operation("lshr", [bits, 52], "i64"), _float_bits(2.0**52)], "i64")
    exponent: Number = code.operation("fsub", [code.cast("bitcast", raised, "double"), 2.0**52 + 1023.0])
    mantissa_bits = code.operation("or", [code.operation("and", [bits, MANTISSA], "i64"), ONE], "i64")
    mantissa: Number = code.cast("bitcast", mantissa_bits, "double")
    large = _compare(code, "ogt", mantissa, math.sqrt(2.0))
    mantissa = code.select(large, code.operation(f"fmul {FLAGS}", [mantissa, 0.5]), mantissa)
    exponent = code.select(large, code.operation(f"fadd {FLAGS}", [exponent, 1.0]), exponent)
    exponent = code.select(tiny, code.operation(f"fsub {FLAGS}", [exponent, 54.0]), exponent)
    f = code.operation(f"fsub {FLAGS}", [mantissa, 1.0])
    s = code.operation("fdiv", [f, code.operation(f"fadd {FLAGS}", [f, 2.0])])
    square = code.operation(f"fmul {FLAGS}", [s, s])
    series = _polynomial(code, [2.0 / odd for odd in range(3, 25, 2)], square)
    # 2 atanh s = 2s + s (s² series), and 2s = f − s f, where f is exact.
    atanh = _multiply_add(
        code, s, code.operation(f"fsub {FLAGS}", [code.operation(f"fmul {FLAGS}", [square, series]), f]), f
    )
    result: Number = _multiply_add(code, exponent, LOG_2_HIGH, _multiply_add(code, exponent, LOG_2_LOW, atanh))
    result = code.select(_compare(code, "oeq", x, math.inf), math.inf, result)
    result = code.select(_compare(code, "oeq", x, 0.0), -math.inf, result)
    return code.select(_compare(code, "uge", x, 0.0), code.select(_compare(code, "uno", x, x), x, result), math.nan)


def logarithm_of_one_plus(code: VectorCode, x: Number) -> Number:
    """Compute log(1 + x) = log u · x/(u − 1) with the rounded u = 1 + x, whose rounding error the quotient cancels (W. Kahan)."""
    if not isinstance(x, Register):
        return math.log1p(x) if x > -1 else -math.inf if x == -1 else math.nan
    u = code.operation("fadd", [x, 1.0])
    lost = code.operation("fsub", [u, 1.0])
    result: Number = code.operation(f"fmul {FLAGS}", [logarithm(code, u), code.operation("fdiv", [x, lost])])
    result = code.select(_compare(code, "oeq", u, math.inf), math.inf, result)
    return code.select(_compare(code, "oeq", lost, 0.0), x, result)


def _compare(code: VectorCode, words: str, a: Number, b: Number) -> Register:
    return code.operation(f"fcmp {words}", [a, b], result="i1")


def _multiply_add(code: VectorCode, a: Number, b: Number, c: Number) -> Register:
    """Return a b + c, fused if the machine has this operation."""
    return code.operation(f"fadd {FLAGS}", [code.operation(f"fmul {FLAGS}", [a, b]), c])


def _polynomial(code: VectorCode, coefficients: Sequence[Number], x: Number) -> Number:
    """Return Σ cᵢ xⁱ by Estrin's scheme, which combines pairs of terms so that few operations wait for each other."""
    while len(coefficients) > 1:
        pairs = [coefficients[i : i + 2] for i in range(0, len(coefficients), 2)]
        coefficients = [_multiply_add(code, pair[1], x, pair[0]) if len(pair) == 2 else pair[0] for pair in pairs]
        x = code.operation(f"fmul {FLAGS}", [x, x])
    return coefficients[0]


def _bits(code: VectorCode, number: Number) -> Register:
    assert isinstance(number, Register)
    return code.cast("bitcast", number, "i64")


def _float_bits(number: float) -> int:
    return int(struct.unpack(">q", struct.pack(">d", number))[0])
