"""The gallery of hysteretic laws: a loop, the parameters, the source and the material of OpenSees for every law."""

from __future__ import annotations

import inspect
import re
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from page_file import write_page_file

from structid.figures.style import CYCLE, canvas, finish, styled
from structid.mechanics.hysteretic_laws.base import HystereticLaw
from structid.mechanics.hysteretic_laws.law_list import LAWS

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from sphinx.application import Sphinx

PAGE = "reference/names/hysteretic_laws.md"
TURNS = np.array([0.2, -0.2, 0.4, -0.4, 0.4, -0.4, 0.8, -0.8, 0.8, -0.8, 0.3, -0.2, 1.2, -1.2, 0.0])
"""Turning points of the drawn loops."""

ABOUT = """# Hysteretic laws

A law is the `law` of `si.Hysteretic` and of `type = "hysteretic"` in a study file. Every loop below has the same path, with the
example values of its table, in any consistent units. No law depends on the mass.

A *polygonal* law is exact for moves of any length. Other laws divide the samples of a cyclic test into shorter moves; their force
error is then below 1 % of the peak. A *passive* law never returns more energy than it has taken, whatever the parameters.

"""


@styled
def _loop(law: HystereticLaw, file: Path) -> Figure:
    """Draw the loop of the example values."""
    path = np.concatenate([np.linspace(a, b, 200)[1:] for a, b in zip(np.append(0.0, TURNS[:-1]), TURNS, strict=True)])
    figure, axes = canvas(1, 1, height=2.2, width=3.6)
    axes[0, 0].plot(path, law.forces_along(path), color=CYCLE[0], lw=0.9)
    axes[0, 0].set_xlabel("deformation")
    axes[0, 0].set_ylabel("force")
    return finish(figure, "", file)


def _text_of(law: type[HystereticLaw]) -> str:
    """Return the docstring as Markdown: literal blocks become fenced ones."""
    text = inspect.getdoc(law) or ""
    text = re.sub(
        r"::\n\n((?: {4}.*\n|\n)+)", lambda m: f":\n\n```text\n{inspect.cleandoc(m[1])}\n```\n\n", text + "\n"
    )
    return text.replace("``", "`")


def _section(law: type[HystereticLaw], folder: Path) -> str:
    example = law().with_values(law.example)
    _loop(example, folder / f"law_{law.word}")
    rows = [
        f"| `{name}` | {p.meaning} | {p.unit or '–'} | {'required' if p.default is None else f'{p.default:g}'} "
        f"| {law.example[name]:g} |"
        if name in law.example
        else f"| `{name}` | {p.meaning} | {p.unit or '–'} | {'required' if p.default is None else f'{p.default:g}'} | |"
        for name, p in law.parameters().items()
    ]
    kind = (
        "polygonal"
        if np.isinf(law.accurate_move)
        else f"moves up to {law.accurate_move:.0%} of the largest deformation"
    )
    facts = [f'`law = "{law.word}"`', kind, *(["passive"] if law.dissipative else [])]
    lines = [
        f"## {law.title[0].upper()}{law.title[1:]}",
        "",
        f"{', '.join(facts)}. For {law.use}." + (f" Source: {law.source}." if law.source else ""),
        "",
        f"![Loop of the law {law.word}](law_{law.word}.png)",
        "",
        _text_of(law),
        "| parameter | meaning | unit | default | example |",
        "| --- | --- | --- | --- | --- |",
        *rows,
        "",
        *([f"OpenSees: `{law.opensees}`", ""] if law.opensees else []),
    ]
    return "\n".join(lines)


def write_page(app: Sphinx) -> None:
    """Write the gallery.

    Parameters
    ----------
    app : Sphinx
        The application.
    """
    folder = (Path(app.srcdir) / PAGE).parent
    folder.mkdir(parents=True, exist_ok=True)
    sections = [_section(law, folder) for law in LAWS.values()]
    write_page_file(Path(app.srcdir) / PAGE, ABOUT + "\n".join(sections) + "\n")
