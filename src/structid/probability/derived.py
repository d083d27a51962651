"""Derived parameters: functions of other parameters, given as functions or as strings."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from structid.core.errors import InputError, suggestion
from structid.probability.expressions import parse_expression

Derivation = Callable[[Mapping[str, Any]], Any]
"""Function of a mapping from parameter names to arrays."""


def derivations(
    sources: Mapping[str, Derivation | str], sampled: Sequence[str], called: str = "derived"
) -> dict[str, Derivation]:
    """Turn the definitions of derived parameters into functions, and check their names."""
    functions: dict[str, Derivation] = {}
    for name, source in sources.items():
        if name in sampled:
            raise InputError(f"{called} '{name}'", "a name that is already used", "a new name", "Rename it.")
        functions[name] = source if callable(source) else _of_text(f"{called} '{name}'", source, [*sampled, *functions])
    return functions


def _of_text(where: str, text: str, known: Sequence[str]) -> Derivation:
    function, needed = parse_expression(text, where)
    for other in needed:
        if other not in known:
            came = f"'{other}' in '{text}'"
            raise InputError(where, came, ", ".join(known), suggestion(other, known))
    return function
