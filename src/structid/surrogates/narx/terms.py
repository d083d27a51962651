"""Terms of a NARX model: readable products of past inputs, outputs and memories, and generators of them.

"The thesis" is the MSc thesis in docs/bibliography.md.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from structid.errors import InputError, check_choice, suggestion
from structid.probability.expressions import parse_expression

Lagged = tuple[str, int]
"""A signal and by how many samples it lies back: ``("y", 1)`` is y(t−1)."""

_AHEAD = re.compile(r"\b([A-Za-z]\w*)\(t\s*\+\s*\d+\)")
_SIGNAL = re.compile(r"\b([A-Za-z]\w*)\(t(?:\s*-\s*(\d+))?\)")
_MEMORY = re.compile(r"^\s*(\w+)\s*=\s*(\w+)\s*\(\s*(\w+)\s*\)\s*$")
_RESERVED = ("t", "pi", "exp", "sin", "cos", "tan", "sqrt", "log", "abs")


@dataclass(frozen=True)
class Term:
    """One term of a NARX model, g(z(t)) (thesis eq. 2.52), such as ``x(t-3)*|y(t-1)|``.

    Signals are scaled: inputs, outputs and integrals are divided by their standard deviation over the training runs, so
    that powers and exponentials are of order one.

    Parameters
    ----------
    text : str
        Lagged signals ``name(t-k)``, numbers, ``t`` (time in seconds), ``+ - * / ^``, ``|…|``, and exp, sin, cos, tan, sqrt, log.

    Raises
    ------
    InputError
        If the text says anything else.
    """

    text: str

    def __post_init__(self) -> None:
        self._parsed  # noqa: B018 - a term that cannot be read is refused where it is made

    @cached_property
    def _parsed(self) -> tuple[Any, tuple[str, ...]]:
        where = f"term '{self.text}'"
        ahead = _AHEAD.search(self.text)
        if ahead:
            raise InputError(where, f"'{ahead[0]}'", f"{ahead[1]}(t-1) or earlier", "What is to come is not known.")
        plain = _SIGNAL.sub(lambda m: m[0] if m[1] in _RESERVED else f"{m[1]}__{int(m[2] or 0)}", self.text)
        plain = _without_bars(plain, where).replace("^", "**")
        function, names = parse_expression(plain, where)
        for name in names:
            if "__" not in name and name not in ("t", "pi"):
                raise InputError(where, f"'{name}'", f"a lagged signal such as {name}(t-1)", "Say when it is taken.")
        return function, names

    @property
    def signals(self) -> tuple[Lagged, ...]:
        """The lagged signals it uses."""
        return tuple(_lagged(name) for name in self._parsed[1] if "__" in name)

    def evaluate(self, values: Mapping[Lagged, Any], time: Any = 0.0) -> Any:
        """Value of the term.

        Parameters
        ----------
        values : mapping of Lagged to array
            The lagged signals, scaled.
        time : float or array
            Time [s].

        Returns
        -------
        array
            As the signals are.
        """
        function, names = self._parsed
        known = {name: values[_lagged(name)] for name in names if "__" in name}
        return function({**known, "t": time, "pi": 3.141592653589793})

    def __str__(self) -> str:
        return self.text


def _without_bars(text: str, where: str) -> str:
    """Write |…| as abs(…), nested ones too: a bar closes where an operand has just ended, and opens where one is due."""
    found, open_bars, operand_ended = "", 0, False
    for letter in text:
        if letter == "|":
            found += ")" if operand_ended else "abs("
            open_bars += -1 if operand_ended else 1
        else:
            found += letter
            if not letter.isspace():
                operand_ended = letter.isalnum() or letter in ")."
        if open_bars < 0:
            break
    if open_bars:
        raise InputError(where, f"'{text}'", "bars in pairs, |…|")
    return found


def _lagged(name: str) -> Lagged:
    signal, _, lag = name.rpartition("__")
    return signal, int(lag)


@dataclass(frozen=True)
class Memory:
    """A signal that remembers more than a few samples, made of another one; terms may use it from lag 1 on.

    ``integral(s)``: m(t) = m(t−1) + ½ (s(t) + s(t−1)), divided by its standard deviation over the training runs.
    ``hysteresis(s)``: Δm = Δs − b |Δs| m − g Δs |m|, Bouc–Wen's law with two shape parameters that are trained with the
    coefficients, and like them may depend on the parameters of the model; Δs is the change of s over the last step.

    Parameters
    ----------
    name : str
        What terms call it.
    kind : {"integral", "hysteresis"}
        How it remembers.
    of : str
        An input, an output, or a memory made before.
    """

    name: str
    kind: str
    of: str

    def __post_init__(self) -> None:
        check_choice(f"memory '{self.name}'", self.kind, ("integral", "hysteresis"))
        if self.name in _RESERVED:
            raise InputError("memory", f"the name '{self.name}'", "another name", "It is that of a function.")

    @classmethod
    def parse(cls, text: str) -> Memory:
        """Read ``z = hysteresis(y)``.

        Parameters
        ----------
        text : str
            Name, kind and signal.

        Returns
        -------
        Memory
            The memory.
        """
        match = _MEMORY.match(text)
        if match is None:
            raise InputError("memory", f"'{text}'", "such as 'u = integral(y)' or 'z = hysteresis(u)'")
        return cls(match[1], match[2], match[3])

    @property
    def shapes(self) -> int:
        """How many shape parameters it has."""
        return 2 if self.kind == "hysteresis" else 0

    def __str__(self) -> str:
        return f"{self.name} = {self.kind}({self.of})"


def as_terms(given: Iterable[Term | str] | Term | str) -> tuple[Term, ...]:
    """Return terms, those that are texts read.

    Parameters
    ----------
    given : iterable of Term or str, or one
        Terms.

    Returns
    -------
    tuple of Term
        Each once, in order.
    """
    listed = [given] if isinstance(given, (str, Term)) else given
    return tuple(dict.fromkeys(t if isinstance(t, Term) else Term(t) for t in listed))


def as_memories(given: Iterable[Memory | str]) -> tuple[Memory, ...]:
    """Return memories, those that are texts read.

    Parameters
    ----------
    given : iterable of Memory or str
        Memories.

    Returns
    -------
    tuple of Memory
        In order.
    """
    return tuple(m if isinstance(m, Memory) else Memory.parse(m) for m in given)


def check_signals(
    terms: Sequence[Term], memories: Sequence[Memory], inputs: Sequence[str], outputs: Sequence[str]
) -> None:
    """Check that every signal of a structure is there, and past where it must be.

    Parameters
    ----------
    terms : sequence of Term
        The terms.
    memories : sequence of Memory
        The memories.
    inputs, outputs : sequence of str
        Names of the signals.

    Raises
    ------
    InputError
        If one is not.
    """
    known = [*inputs, *outputs]
    for memory in memories:
        if memory.of not in known or memory.name in known:
            wrong = memory.of if memory.of not in known else memory.name
            raise InputError(f"memory '{memory}'", f"the signal '{wrong}'", ", ".join(known), suggestion(wrong, known))
        known.append(memory.name)
    for term in terms:
        for signal, lag in term.signals:
            if signal not in known:
                raise InputError(
                    f"term '{term}'", f"the signal '{signal}'", ", ".join(known), suggestion(signal, known)
                )
            if signal not in inputs and lag < 1:
                raise InputError(f"term '{term}'", f"{signal}(t)", f"{signal}(t-1) or earlier", "It is not known yet.")


def _past(signal: str, first: int, last: int) -> list[str]:
    return [f"{signal}(t-{k})" if k else f"{signal}(t)" for k in range(first, last + 1)]


def polynomial_terms(
    n_x: int = 4, n_y: int = 4, degree: int = 2, inputs: Sequence[str] = ("x",), outputs: Sequence[str] = ("y",)
) -> tuple[Term, ...]:
    """Every product of lagged signals up to a degree, the constant among them.

    Parameters
    ----------
    n_x, n_y : int
        Largest lags of inputs and outputs.
    degree : int
        Largest degree.
    inputs, outputs : sequence of str
        Names of the signals.

    Returns
    -------
    tuple of Term
        The terms.
    """
    factors = [f for s in inputs for f in _past(s, 0, n_x)] + [f for s in outputs for f in _past(s, 1, n_y)]
    products = itertools.chain.from_iterable(
        itertools.combinations_with_replacement(factors, d) for d in range(1, degree + 1)
    )
    return as_terms(["1", *("*".join(p) for p in products)])


def absolute_terms(
    n_x: int = 4, n_y: int = 4, inputs: Sequence[str] = ("x",), outputs: Sequence[str] = ("y",)
) -> tuple[Term, ...]:
    """x(t−k)^l |y(t−1)|^m and y(t−j)^l |y(t−1)|^m with l, m in {0, 1} (thesis eqs. 3.27, 3.28), the constant left out.

    Parameters
    ----------
    n_x, n_y : int
        Largest lags of inputs and outputs.
    inputs, outputs : sequence of str
        Names of the signals.

    Returns
    -------
    tuple of Term
        For one input and one output with lags of four: the thesis's 19.
    """
    linear = [f for s in inputs for f in _past(s, 0, n_x)] + [f for s in outputs for f in _past(s, 1, n_y)]
    size = [f"|{s}(t-1)|" for s in outputs]
    return as_terms([*linear, *size, *(f"{f}*{a}" for a in size for f in linear)])


def exponential_terms(n_x: int = 4, inputs: Sequence[str] = ("x",)) -> tuple[Term, ...]:
    """x(t−k)², and exp(x(t−k)) (thesis eqs. 5.7, 5.8).

    Parameters
    ----------
    n_x : int
        Largest lag.
    inputs : sequence of str
        Names of the inputs.

    Returns
    -------
    tuple of Term
        The terms.
    """
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
    """Exponential and harmonic terms after Prony's series (thesis eqs. 5.7 to 5.12).

    Parameters
    ----------
    n_x, n_y : int
        Largest lags.
    phase : float
        τ [rad].
    growth : float
        2 σ_max [1/s].
    inputs, outputs : sequence of str
        Names of the signals.

    Returns
    -------
    tuple of Term
        x^l, exp(x), y, x exp(y₁) |y|, y exp(t x) sin(2π y t + τ), x exp(2σt) cos(2πt + τ).
    """
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
    """Terms with a hysteretic memory: what an oscillator with a hysteretic spring needs, whatever its law.

    Each output is integrated until it is a displacement u, and gets a hysteresis z of that; the products with |u'| and |z| make
    up for what happens within a step.

    Parameters
    ----------
    outputs, inputs : sequence of str
        Names of the signals.
    integrations : sequence of int, optional
        For each output how often it is integrated: 0 for a displacement, 1 for a velocity (as when left out), 2 for an
        acceleration.

    Returns
    -------
    tuple of tuple
        Terms, and the memories they use.
    """
    orders = [1] * len(outputs) if integrations is None else list(integrations)
    terms: list[str] = [f for x in inputs for f in _past(x, 0, 3)]
    memories: list[str] = []
    for number, (y, order) in enumerate(zip(outputs, orders, strict=True), 1):
        tag = "" if len(outputs) == 1 else str(number)
        # From the output to the displacement: y and what its integrals are called.
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
    """Terms of a hysteretic spring whose displacement is imposed: the hysteresis is of the input.

    Parameters
    ----------
    outputs, inputs : sequence of str
        Names of the signals.

    Returns
    -------
    tuple of tuple
        Terms, and the memories they use.
    """
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
