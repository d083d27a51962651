"""How things that print well are shown in a notebook."""

from __future__ import annotations

import html


class ShownAsText:
    """Something whose text is a table or a verdict: a notebook shows it as it is printed, in columns."""

    def _repr_html_(self) -> str:
        return f"<pre>{html.escape(str(self))}</pre>"
