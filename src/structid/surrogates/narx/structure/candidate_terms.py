"""Candidate terms of a NARX: polynomial, absolute, exponential, Prony and hysteretic.

"The thesis" is the MSc thesis in docs/bibliography.md.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

from structid.surrogates.narx.structure.terms import Memory, Term, as_memories, as_terms


def polynomial_terms(
    n_x: int = 4, n_y: int = 4, degree: int = 2, inputs: Sequence[str] = ("x",), outputs: Sequence[str] = ("y",)
) -> tuple[Term, ...]:
    """Return every product of lagged signals up to a degree, including the constant."""
    factors = [f for s in inputs for f in _past(s, 0, n_x)] + [f for s in outputs for f in _past(s, 1, n_y)]
    products = itertools.chain.from_iterable(
        itertools.combinations_with_replacement(factors, d) for d in range(1, degree + 1)
    )
    return as_terms(["1", *("*".join(p) for p in products)])


def absolute_terms(
    n_x: int = 4, n_y: int = 4, inputs: Sequence[str] = ("x",), outputs: Sequence[str] = ("y",)
) -> tuple[Term, ...]:
    """Return x(t−k)^l |y(t−1)|^m and y(t−j)^l |y(t−1)|^m with l, m in {0, 1}, without the constant (thesis eqs. 3.27, 3.28)."""
    linear = [f for s in inputs for f in _past(s, 0, n_x)] + [f for s in outputs for f in _past(s, 1, n_y)]
    size = [f"|{s}(t-1)|" for s in outputs]
    return as_terms([*linear, *size, *(f"{f}*{a}" for a in size for f in linear)])


def exponential_terms(n_x: int = 4, inputs: Sequence[str] = ("x",)) -> tuple[Term, ...]:
    """Return x(t−k)² and exp(x(t−k)) (thesis eqs. 5.7, 5.8)."""
    factors = [f for s in inputs for f in _past(s, 0, n_x)]
    return as_terms([*(f"{f}^2" for f in factors), *(f"exp({f})" for f in factors)])


def prony_terms(
    n_x: int = 10,
    n_y: int = 5,
    phase: float = 0.0,
    growth: float = 0.0,
    inputs: Sequence[str] = ("x",),
    outputs: Sequence[str] = ("y",),
) -> tuple[Term, ...]:
    """Return exponential and harmonic terms modelled on the Prony series (thesis eqs. 5.7 to 5.12)."""
    terms = ["1"]
    for x in inputs:
        for now in _past(x, 0, n_x):
            terms += [now, f"{now}^2", f"exp({now})", f"{now}*exp({growth}*t)*cos(2*pi*t + {phase})"]
    for y in outputs:
        for j, past in enumerate(_past(y, 1, n_y), 1):
            for x in inputs:
                now = _past(x, 0, max(n_x, j))[min(j, n_x)]
                terms += [
                    past,
                    f"{now}*exp({y}(t-1))*|{past}|",
                    f"{past}*exp(t*{now})*sin(2*pi*{past}*t + {phase})",
                ]
    return as_terms(terms)


def hysteretic_terms(
    outputs: Sequence[str] = ("y",), inputs: Sequence[str] = ("x",), integrations: Sequence[int] | None = None
) -> tuple[tuple[Term, ...], tuple[Memory, ...]]:
    """Return terms with a hysteretic memory, for an oscillator with any hysteretic spring.

    Each output is integrated to a displacement u, which drives a hysteresis z. The products with |u'| and |z| account for
    changes within a time step.
    """
    orders = [1] * len(outputs) if integrations is None else list(integrations)
    terms: list[str] = [f for x in inputs for f in _past(x, 0, 3)]
    memories: list[str] = []
    for number, (y, order) in enumerate(zip(outputs, orders, strict=True), 1):
        tag = "" if len(outputs) == 1 else str(number)
        # The chain from the output to the displacement has y and the names of its integrals.
        chain = [y, *([], [f"u{tag}"], [f"v{tag}", f"u{tag}"])[order]]
        z = f"z{tag}"
        memories += [f"{integral} = integral({of})" for of, integral in itertools.pairwise(chain)]
        memories += [f"{z} = hysteresis({chain[-1]})"]
        past, held = _past(y, 1, 3), _past(z, 1, 2)
        speed = f"|{chain[-2]}(t-1)|" if order else f"|{y}(t-1) - {y}(t-2)|"
        loops = [f"{x}(t)" for x in inputs] + [f"{x}(t-1)" for x in inputs]
        terms += [*past, *(f"{integral}(t-1)" for integral in chain[1:]), *held]
        terms += [f"{f}*{speed}" for f in (*past[:2], *held, *loops)]
        terms += [f"{f}*|{z}(t-1)|" for f in past[:2]]
    return as_terms(terms), as_memories(memories)


def displacement_driven_terms(
    outputs: Sequence[str] = ("y",), inputs: Sequence[str] = ("x",)
) -> tuple[tuple[Term, ...], tuple[Memory, ...]]:
    """Return terms of a hysteretic spring under imposed displacement, in which the input drives the hysteresis."""
    terms: list[str] = []
    memories: list[str] = []
    for number, x in enumerate(inputs, 1):
        z = "z" if len(inputs) == 1 else f"z{number}"
        memories += [f"{z} = hysteresis({x})"]
        step, held = f"({x}(t) - {x}(t-1))", _past(z, 1, 2)
        size = f"|{x}(t) - {x}(t-1)|"
        terms += [*_past(x, 0, 3), *held, size]
        terms += [f"{z}(t-1)*{size}", f"{step}*|{z}(t-1)|", f"{step}*{z}(t-1)^2", f"{z}(t-1)*|{z}(t-1)|*{size}"]
        terms += [f"{f}*{size}" for y in outputs for f in _past(y, 1, 1)]
    terms += [f for y in outputs for f in _past(y, 1, 2)]
    return as_terms(terms), as_memories(memories)


def _past(signal: str, first: int, last: int) -> list[str]:
    """Return the names of a signal at a range of lags."""
    return [f"{signal}(t-{k})" if k else f"{signal}(t)" for k in range(first, last + 1)]
