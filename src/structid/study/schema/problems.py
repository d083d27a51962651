"""Messages for the problems of a study file."""

from __future__ import annotations

import difflib
import re
from typing import Any, get_args, get_origin

from pydantic import BaseModel

from structid.core.errors import InputError, suggestion


class StudyErrors(InputError):
    """All problems of a study file."""

    def __init__(self, path: str, problems: list[str]) -> None:
        self.path, self.problems = path, problems
        Exception.__init__(self, "\n".join(f"{path}: {p}" for p in problems))

    def __reduce__(self) -> Any:
        return (StudyErrors, (self.path, self.problems))


_VARIANTS = {"float", "str", "PriorTable", "int"}
"""Elements of pydantic's error locations that name a variant of a type, not a key."""


def problem(error: Any, content: dict[str, Any], schema: type[BaseModel]) -> str:
    """Describe one problem in a paragraph: key, given value, expected value, remedy."""
    words, tags = _words_of_models(schema), _tags(schema)
    steps = [
        s
        for s in error["loc"]
        if not (isinstance(s, str) and (s in _VARIANTS or s in tags or "[" in s or "tuple" in s))
    ]
    if steps[:1] == ["observation"] and isinstance(content.get("observation"), dict):
        steps = [s for s in steps if s != 0]  # a single table is a list with one element
    key = _counted_from_one(steps) or "the file"
    cause = error.get("ctx", {}).get("error")
    if isinstance(cause, InputError):
        what = f"{cause.where}: " if cause.where.startswith("unit ") else ""
        return f"key '{key}': {what}{cause.came}. Expected: {cause.allowed}.{' ' + cause.cure if cause.cure else ''}"
    match error["type"]:
        case "extra_forbidden":
            known_keys = _known_keys(steps[:-1], content, schema)
            near = difflib.get_close_matches(str(steps[-1]), known_keys, n=1, cutoff=0.4)
            hint = f" Did you mean '{near[0]}'?" if near else ""
            return f"key '{key}': an unknown key. Allowed here: {', '.join(known_keys)}.{hint}"
        case "missing":
            return f"key '{key}': it is missing. Add it."
        case "literal_error":
            return f"key '{key}': {error['input']!r}. Expected: {error['ctx']['expected']}."
        case "union_tag_invalid":
            tag, expected = error["ctx"]["tag"], error["ctx"]["expected_tags"]
            cure = suggestion(tag, re.findall(r"'(\w+)'", expected))
            return f"key '{key}.type': '{tag}'. Expected: {expected}. {cure}".rstrip()
        case "union_tag_not_found":
            *most, last = (f"'{word}'" for word in words)
            return f"key '{key}.type': it is missing. Expected: {', '.join(most)} or {last}."
        case _:
            allowed = _allowed(error)
            return f"key '{key}': {error['input']!r}. {f'Expected: {allowed}' if allowed else error['msg']}."


def _counted_from_one(steps: list[Any]) -> str:
    """Location in the file as a dotted key; the second [[observation]] is ``observation.2``."""
    return ".".join(str(s + 1) if isinstance(s, int) else str(s) for s in steps)


KINDS_OF_VALUE = {
    **dict.fromkeys(("float_type", "float_parsing"), "a number"),
    **dict.fromkeys(("int_type", "int_parsing", "int_from_float"), "a whole number"),
    **dict.fromkeys(("bool_type", "bool_parsing"), "true or false"),
    **dict.fromkeys(("list_type", "tuple_type"), "a list in brackets, [ ]"),
    **dict.fromkeys(("dict_type", "model_type", "model_attributes_type", "dataclass_type"), "a table"),
    "string_type": "a text in quotes",
    "finite_number": "a finite number",
}
"""Descriptions of the expected value, by pydantic's error type."""
LIMITS = {"gt": "more than", "ge": "at least", "lt": "less than", "le": "at most"}
"""Descriptions of limits, by pydantic's names for them."""


def _allowed(error: Any) -> str:
    """Description of the expected value; empty if pydantic's own message is clearest."""
    context, kind = error.get("ctx", {}), error["type"]
    if kind in ("too_short", "too_long"):
        limit = context.get("min_length", context.get("max_length"))
        return f"{'at least' if kind == 'too_short' else 'at most'} {limit} value{'' if limit == 1 else 's'}"
    for name, words in LIMITS.items():
        if name in context:
            limit = context[name]
            return f"{words} {limit:g}" if isinstance(limit, float) else f"{words} {limit}"
    return KINDS_OF_VALUE.get(kind, "")


def _words_of_models(schema: type[BaseModel]) -> list[str]:
    """Names of all kinds of model."""
    return _words_of(_tables(schema.model_fields["model"].annotation))


def _tags(schema: type[BaseModel]) -> set[str]:
    """Names of all kinds in all tables; pydantic adds these names to its error locations."""
    return {word for field in schema.model_fields.values() for word in _words_of(_tables(field.annotation))}


def _words_of(tables: list[Any]) -> list[str]:
    """Possible values of the key ``type`` in some tables."""
    typed = [table.model_fields["type"].annotation for table in tables if "type" in table.model_fields]
    return [word for annotation in typed for word in get_args(annotation) if isinstance(word, str)]


def _known_keys(steps: list[Any], content: dict[str, Any], schema: type[BaseModel]) -> list[str]:
    """Keys of the table at a location of the file."""
    tables: list[Any] = [schema]
    here: Any = content
    named = False  # whether the next step is a user-defined name, which may equal the name of a key
    for step in steps:
        here = here[step] if isinstance(here, (dict, list)) and (isinstance(step, int) or step in here) else {}
        if isinstance(step, int) or named:
            named = False
            continue
        fields = [table.model_fields[step] for table in tables if step in table.model_fields]
        named = any(get_origin(field.annotation) is dict for field in fields)
        tables = [table for field in fields for table in _tables(field.annotation)]
    kind = here.get("type") if isinstance(here, dict) else None
    if kind is not None:
        typed = [t for t in tables if "type" in t.model_fields]
        tables = [t for t in typed if kind in get_args(t.model_fields["type"].annotation)] or tables
    return sorted({name for table in tables for name in table.model_fields})


def _tables(annotation: Any) -> list[Any]:
    """All tables that the annotation of a field allows."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    arguments = get_args(annotation) if get_origin(annotation) is not None else ()
    return [table for argument in arguments for table in _tables(argument)]
