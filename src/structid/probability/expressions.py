"""Functions of named arrays from arithmetic strings such as ``"gamma_ratio * beta"``; no other code is executed."""

from __future__ import annotations

import ast
import operator
from collections.abc import Callable, Mapping
from typing import Any

from structid.core.errors import InputError, suggestion

_OPERATORS: dict[type, Callable[..., Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: operator.pow,
    ast.USub: operator.neg,
    ast.UAdd: operator.pos,
}
_FUNCTIONS = ("sqrt", "exp", "log", "sin", "cos", "tan", "abs")


def parse_expression(text: str, where: str) -> tuple[Callable[[Mapping[str, Any]], Any], tuple[str, ...]]:
    """Turn an arithmetic expression into a function of named arrays."""
    try:
        tree = ast.parse(text, mode="eval").body
    except SyntaxError as cause:
        raise InputError(where, f"'{text}'", "an arithmetic expression such as 'gamma_ratio * beta'") from cause
    names: list[str] = []
    _check(tree, text, where, names)
    return lambda values: _evaluate(tree, values), tuple(dict.fromkeys(names))


def _check(node: ast.AST, text: str, where: str, names: list[str]) -> None:
    match node:
        case ast.Constant(value=int() | float()):
            return
        case ast.Name(id=name):
            names.append(name)
        case ast.BinOp(left=left, op=op, right=right) if type(op) in _OPERATORS:
            _check(left, text, where, names)
            _check(right, text, where, names)
        case ast.UnaryOp(op=op, operand=operand) if type(op) in _OPERATORS:
            _check(operand, text, where, names)
        case ast.Call(func=ast.Name(id=name), args=[argument], keywords=[]):
            if name not in _FUNCTIONS:
                raise InputError(
                    where,
                    f"unknown function '{name}' in '{text}'",
                    ", ".join(_FUNCTIONS),
                    suggestion(name, _FUNCTIONS),
                )
            _check(argument, text, where, names)
        case _:
            raise InputError(
                where,
                f"'{ast.unparse(node)}' in '{text}'",
                "numbers, names, + - * / ** and functions of one argument",
            )


def _evaluate(node: ast.AST, values: Mapping[str, Any]) -> Any:
    match node:
        case ast.Constant(value=value):
            return value
        case ast.Name(id=name):
            return values[name]
        case ast.BinOp(left=left, op=op, right=right):
            return _OPERATORS[type(op)](_evaluate(left, values), _evaluate(right, values))
        case ast.UnaryOp(op=op, operand=operand):
            return _OPERATORS[type(op)](_evaluate(operand, values))
        case ast.Call(func=ast.Name(id=name), args=[argument]):
            return _call(name, _evaluate(argument, values))
    raise AssertionError(ast.dump(node))  # _check rejects everything else


def _call(name: str, argument: Any) -> Any:
    from structid.engine.device import jnp

    return getattr(jnp, name)(argument)
