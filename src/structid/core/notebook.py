"""How things that print well are shown in a notebook."""

from __future__ import annotations

import html
import io
import sys
from typing import Any


class ShownAsText:
    """Something whose text is a table or a verdict: a notebook shows it as it is printed, in columns."""

    def _repr_html_(self) -> str:
        return f'<pre style="font-size: 0.85em; overflow-x: auto">{html.escape(str(self))}</pre>'


def shown_as_pictures(figures: type[Any]) -> None:
    """Let a notebook show matplotlib's figures as pictures, whether or not pyplot is in use there; nothing where there is none."""
    running = sys.modules.get("IPython")
    shell = None if running is None else running.get_ipython()
    if shell is None:
        return
    pictures = shell.display_formatter.formatters["image/png"]
    try:
        pictures.lookup_by_type(figures)
    except KeyError:
        pictures.for_type(figures, _png)


def _png(figure: Any) -> bytes:
    drawn = io.BytesIO()
    figure.savefig(drawn, format="png", dpi=110)
    return drawn.getvalue()
