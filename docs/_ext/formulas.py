"""Formulas as MathML, which browsers draw by themselves: no script, no network, and readable in print and to a screen reader."""

from __future__ import annotations

import re
from typing import Any

import latex2mathml.converter
from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.math import get_node_equation_number

_ALIGNED = re.compile(r"\\begin\{aligned\}(.*?)\\end\{aligned\}", re.DOTALL)


def _mathml(formula: str) -> str:
    """A displayed formula; one that is aligned becomes a table, which the converter does not know."""
    aligned = _ALIGNED.fullmatch(formula.strip())
    if not aligned:
        return latex2mathml.converter.convert(formula, display="block")
    rows = [row.split("&") for row in re.split(r"\\\\(?:\[[^\]]*\])?", aligned[1]) if row.strip()]
    return f'<math display="block"><mtable>{"".join(map(_row, rows))}</mtable></math>'


def _row(cells: list[str]) -> str:
    sides = ["right", "left"]
    drawn = []
    for place, cell in enumerate(cells):
        inside = latex2mathml.converter.convert(cell, display="block")
        content = inside[inside.index(">") + 1 : inside.rindex("</math>")]
        drawn.append(f'<mtd style="text-align: {sides[place % 2]}; padding: .35em .1em">{content}</mtd>')
    return f'<mtr displaystyle="true">{"".join(drawn)}</mtr>'


def _inline(writer: Any, node: nodes.math) -> None:
    writer.body.append(latex2mathml.converter.convert(node.astext()))
    raise nodes.SkipNode


def _displayed(writer: Any, node: nodes.math_block) -> None:
    number = ""
    if node["number"]:
        number = f'<span class="eqno">({get_node_equation_number(writer, node)})</span>'
    anchor = "".join(f' id="{name}"' for name in node["ids"][:1])
    drawn = _mathml(node.astext())
    writer.body.append(f'<div class="math"{anchor}>{number}{drawn}</div>\n')
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the renderer.

    Parameters
    ----------
    app : Sphinx
        The application.

    Returns
    -------
    dict
        What Sphinx wants to know of an extension.
    """
    app.add_html_math_renderer("mathml", (_inline, None), (_displayed, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
