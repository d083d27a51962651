"""NARX terms as strings: readable products of past inputs, outputs and memories.

"The thesis" is the MSc thesis in docs/bibliography.md.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from structid.core.errors import InputError, check_choice, suggestion
from structid.core.validation import check_arguments
from structid.probability.expressions import parse_expression

Lagged = tuple[str, int]
"""A signal and its lag in samples: ``("y", 1)`` is y(t−1)."""

_AHEAD = re.compile(r"\b([A-Za-z]\w*)\(t\s*\+\s*\d+\)")

_SIGNAL = re.compile(r"\b([A-Za-z]\w*)\(t(?:\s*-\s*(\d+))?\)")

_MEMORY = re.compile(r"^\s*(\w+)\s*=\s*(\w+)\s*\(\s*(\w+)\s*\)\s*$")

_RESERVED = ("t", "pi", "exp", "sin", "cos", "tan", "sqrt", "log", "abs")


@dataclass(frozen=True)
class Term:
    """One term of a NARX model, g(z(t)) (thesis eq. 2.52), such as ``x(t-3)*|y(t-1)|``.

    Signals are scaled: inputs, outputs and integrals are divided by their standard deviation over the training runs. Powers and
    exponentials are then of order one.

    Parameters
    ----------
    text : str
        Lagged signals ``name(t-k)``, numbers, ``t`` (time in seconds), ``+ - * / ^``, ``|…|``, and exp, sin, cos, tan, sqrt, log.

    Raises
    ------
    InputError
        If the string contains anything else.

    Examples
    --------
    >>> import structid as si
    >>> print(si.Term("|y(t-1)| * x(t)"))
    |y(t-1)| * x(t)
    """

    text: str

    def __post_init__(self) -> None:
        self._parsed  # noqa: B018 - a term that cannot be read is refused when it is made

    @cached_property
    def _parsed(self) -> tuple[Any, tuple[str, ...]]:
        """Function that evaluates the term, and names of its arguments."""
        where = f"term '{self.text}'"
        ahead = _AHEAD.search(self.text)
        if ahead:
            raise InputError(where, f"'{ahead[0]}'", f"{ahead[1]}(t-1) or earlier", "Use past values only.")
        plain = _SIGNAL.sub(lambda m: m[0] if m[1] in _RESERVED else f"{m[1]}__{int(m[2] or 0)}", self.text)
        plain = _without_bars(plain, where).replace("^", "**")
        function, names = parse_expression(plain, where)
        for name in names:
            if "__" not in name and name not in ("t", "pi"):
                raise InputError(where, f"'{name}'", f"a lagged signal such as {name}(t-1)", "Give the lag.")
        return function, names

    @property
    def signals(self) -> tuple[Lagged, ...]:
        """Lagged signals that the term uses."""
        return tuple(_lagged(name) for name in self._parsed[1] if "__" in name)

    def evaluate(self, values: Mapping[Lagged, Any], time: Any = 0.0) -> Any:
        """Evaluate the term.

        Parameters
        ----------
        values : mapping of Lagged to array
            The lagged signals, scaled.
        time : float or array
            Time [s].

        Returns
        -------
        array
            Value of the term, in the shape of the signals.
        """
        function, names = self._parsed
        lagged = {name: values[_lagged(name)] for name in names if "__" in name}
        return function({**lagged, "t": time, "pi": 3.141592653589793})

    def __str__(self) -> str:
        return self.text


def _without_bars(text: str, where: str) -> str:
    """Replace |…| by abs(…), also if nested: a bar after an operand closes, and a bar in place of an operand opens."""
    result, open_bars, operand_ended = "", 0, False
    for letter in text:
        if letter == "|":
            result += ")" if operand_ended else "abs("
            open_bars += -1 if operand_ended else 1
        else:
            result += letter
            if not letter.isspace():
                operand_ended = letter.isalnum() or letter in ")."
        if open_bars < 0:
            break
    if open_bars:
        raise InputError(where, f"'{text}'", "bars in pairs, |…|")
    return result


def _lagged(name: str) -> Lagged:
    """Return the lagged signal of a name such as ``y__1``."""
    signal, _, lag = name.rpartition("__")
    return signal, int(lag)


@check_arguments
@dataclass(frozen=True)
class Memory:
    """A signal with a long memory, derived from another signal; terms may use it with lags of 1 or more.

    ``integral(s)``: m(t) = m(t−1) + ½ (s(t) + s(t−1)), divided by its standard deviation over the training runs.
    ``hysteresis(s)``: ``Δm = Δs − b |Δs| m − g Δs |m|``, the Bouc–Wen law, where Δs is the change of s over the last step. The two
    shape parameters b and g are trained with the coefficients. Like coefficients, they may depend on the model's parameters.

    Parameters
    ----------
    name : str
        Name of the memory in terms.
    kind : {"integral", "hysteresis"}
        Kind of memory.
    of : str
        Source signal: an input, an output or an earlier memory.

    Examples
    --------
    >>> import structid as si
    >>> si.Memory("z", kind="hysteresis", of="y").of
    'y'
    """

    name: str
    kind: str
    of: str

    def __post_init__(self) -> None:
        check_choice(f"memory '{self.name}'", self.kind, ("integral", "hysteresis"))
        if self.name in _RESERVED:
            raise InputError("memory", f"the name '{self.name}' is a function", "another name", "Rename the memory.")

    @classmethod
    def parse(cls, text: str) -> Memory:
        """Read a string such as ``z = hysteresis(y)``.

        Parameters
        ----------
        text : str
            Name, kind and source signal.

        Returns
        -------
        Memory
            The memory.

        Raises
        ------
        InputError
            If the string does not have the form ``name = kind(source)``.
        """
        match = _MEMORY.match(text)
        if match is None:
            raise InputError("memory", f"'{text}'", "a string such as 'u = integral(y)' or 'z = hysteresis(u)'")
        return cls(match[1], match[2], match[3])

    @property
    def shapes(self) -> int:
        """Number of shape parameters of the memory."""
        return 2 if self.kind == "hysteresis" else 0

    def __str__(self) -> str:
        return f"{self.name} = {self.kind}({self.of})"


def as_terms(given: Iterable[Term | str] | Term | str) -> tuple[Term, ...]:
    """Return terms; strings are parsed."""
    listed = [given] if isinstance(given, (str, Term)) else given
    return tuple(dict.fromkeys(t if isinstance(t, Term) else Term(t) for t in listed))


def as_memories(given: Iterable[Memory | str]) -> tuple[Memory, ...]:
    """Parse memories given as strings; return the others unchanged."""
    return tuple(m if isinstance(m, Memory) else Memory.parse(m) for m in given)


def check_signals(
    terms: Sequence[Term], memories: Sequence[Memory], inputs: Sequence[str], outputs: Sequence[str]
) -> None:
    """Check that every signal of a structure exists, and that outputs and memories have a lag."""
    names = [*inputs, *outputs]
    for memory in memories:
        if memory.of not in names or memory.name in names:
            wrong = memory.of if memory.of not in names else memory.name
            raise InputError(f"memory '{memory}'", f"the signal '{wrong}'", ", ".join(names), suggestion(wrong, names))
        names.append(memory.name)
    for term in terms:
        for signal, lag in term.signals:
            if signal not in names:
                raise InputError(
                    f"term '{term}'", f"the signal '{signal}'", ", ".join(names), suggestion(signal, names)
                )
            if signal not in inputs and lag < 1:
                raise InputError(f"term '{term}'", f"{signal}(t)", f"{signal}(t-1) or earlier", "Use a past value.")
