"""Display of results and figures in a notebook."""

from __future__ import annotations

import html
import io
import sys
from typing import Any


class ShownAsText:
    """Mixin for objects that print as a table: a notebook displays the printed text."""

    def _repr_html_(self) -> str:
        return f'<pre style="font-size: 0.85em; overflow-x: auto">{html.escape(str(self))}</pre>'


def shown_as_pictures(figures: type[Any]) -> None:
    """Make a notebook display matplotlib figures as pictures, with or without pyplot; do nothing outside a notebook."""
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
