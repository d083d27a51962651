"""All quantities of a study file converted to SI, which reveals confused units such as ton and tonne."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from structid.core.units import in_si, is_quantity
from structid.study.schema.study_file import study_text


def quantities_in_si(path: str | Path) -> list[str]:
    """List the quantities of a study file with their values in SI."""
    content = tomllib.loads(study_text(Path(path)))
    quantities = [(key, text) for key, text in _texts(content) if is_quantity(text)]
    width = max((len(key) for key, _ in quantities), default=0)
    return [f"{key.ljust(width)}  {text} = {in_si(text)}" for key, text in quantities]


def _texts(content: Any, where: str = "") -> Iterator[tuple[str, str]]:
    """All strings of nested tables and lists, with their keys."""
    items = (
        content.items()
        if isinstance(content, dict)
        else enumerate(content, start=1)
        if isinstance(content, list)
        else ()
    )
    for key, value in items:
        key_of_item = f"{where}.{key}" if where else str(key)
        if isinstance(value, str):
            yield key_of_item, value
        else:
            yield from _texts(value, key_of_item)
