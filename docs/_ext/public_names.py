"""A reference page for every public name, and an index by what they are for; both are written when the site is built."""

from __future__ import annotations

import enum
import inspect
from pathlib import Path
from typing import Any

from page_file import write_page_file
from sphinx.application import Sphinx

import structid

FOLDER = "reference/names"
"""Where the pages go, below the documents."""

TOPICS = {
    "ground_motion": "Records and other excitations",
    "data_files": "Measurements",
    "observation": "Measurements",
    "probability": "Parameters and priors",
    "models": "Models",
    "models.masonry": "Masonry walls",
    "models.external": "Your own solver",
    "campaign": "Runs of a model",
    "histories": "Runs of a model",
    "surrogates": "Surrogates",
    "inference": "Posterior, error models, samplers, checks",
    "law_choice": "Cyclic tests and the choice of a hysteretic law",
    "calibration": "Certified calibration",
    "certification": "Certified calibration",
    "reliability": "First passages and fragility",
    "optimize": "Deterministic calibration",
    "hybrid": "Hybrid tests",
    "report": "The report",
    "core.progress_bars": "In a notebook",
    "core.errors": "Errors and statuses",
}
"""Rooms of the package, in the order of the index, and what they are called there. A room that is missing stops the building."""


def _topic(name: str) -> str:
    """Topic of the innermost room that has one."""
    room = structid._PUBLIC.get(name, name)
    while room not in TOPICS:
        room, dot, _ = room.rpartition(".")
        if not dot:
            raise KeyError(f"{name}: no room of {structid._PUBLIC.get(name, name)} is in TOPICS; add it there.")
    return TOPICS[room]


def _names() -> list[str]:
    return sorted(n for n in structid.__all__ if not n.startswith("_"))


def _first_sentence(thing: Any) -> str:
    said = inspect.getdoc(thing) or ""
    return said.split("\n\n")[0].replace("\n", " ").replace("`", "``")


def _directive(name: str, thing: Any) -> str:
    if inspect.isclass(thing) and issubclass(thing, enum.Enum):
        return f".. autoclass:: structid.{name}\n   :members:\n   :undoc-members:\n"
    if inspect.isclass(thing):
        return f".. autoclass:: structid.{name}\n   :members:\n   :inherited-members: object, Exception, Warning\n"
    if inspect.ismodule(thing):
        return f".. automodule:: structid.{name}\n   :members:\n   :imported-members:\n"
    return f".. autofunction:: structid.{name}\n" if callable(thing) else f".. autodata:: structid.{name}\n"


def write_pages(app: Sphinx) -> None:
    """Write all pages, and remove those of names that are no longer public.

    Parameters
    ----------
    app : Sphinx
        The application.
    """
    folder = Path(app.srcdir) / FOLDER
    names = _names()
    by_topic: dict[str, list[str]] = {topic: [] for topic in TOPICS.values()}
    for name in names:
        by_topic[_topic(name)].append(name)
        thing = getattr(structid, name)
        title = f"structid.{name}"
        write_page_file(folder / f"{name}.rst", f"{title}\n{'=' * len(title)}\n\n{_directive(name, thing)}")
    for page in set(folder.glob("*.rst")) - {folder / f"{name}.rst" for name in [*names, "index"]}:
        page.unlink()
    write_page_file(folder / "index.rst", _index(by_topic))


def _index(by_topic: dict[str, list[str]]) -> str:
    lines = [
        "Python",
        "======",
        "",
        "Every public name, by what it is for: ``import structid as si``, then ``si.NAME``.",
        "",
    ]
    for topic, names in by_topic.items():
        if not names:
            continue
        lines += [topic, "-" * len(topic), "", ".. list-table::", "   :widths: 28 72", ""]
        for name in names:
            lines += [f"   * - :doc:`{name} <{name}>`", f"     - {_first_sentence(getattr(structid, name))}"]
        lines += ["", ".. toctree::", "   :hidden:", "", *(f"   {name}" for name in names), ""]
    return "\n".join(lines)
