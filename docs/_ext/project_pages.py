"""Pages of the site from files in the repository's root: the changelog and what developers read."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from sphinx.application import Sphinx

FOLDER = "project"
"""Where the pages go, below the documents."""

FILES = ("ARCHITECTURE.md", "CHANGELOG.md", "CONTRIBUTING.md", "SECURITY.md")

_LINK = re.compile(r"\]\((?!https?:|#)([^)]+)\)")


def _page_of(target: str) -> str:
    """Where a link of a file in the root leads on the site."""
    return target.lower() if target in FILES else target.replace("docs/", "../", 1)


def write_pages(app: Sphinx) -> None:
    """Write the pages, their links turned.

    Parameters
    ----------
    app : Sphinx
        The application.
    """
    folder = Path(app.srcdir) / FOLDER
    folder.mkdir(exist_ok=True)
    for name in FILES:
        text = (Path(app.srcdir).parent / name).read_text(encoding="utf-8")
        turned = _LINK.sub(lambda link: f"]({_page_of(link[1])})", text)
        page = folder / name.lower()
        if not page.is_file() or page.read_text(encoding="utf-8") != turned:
            page.write_text(turned, encoding="utf-8")


def setup(app: Sphinx) -> dict[str, Any]:
    """Write the pages when the building begins.

    Parameters
    ----------
    app : Sphinx
        The application.

    Returns
    -------
    dict
        What Sphinx wants to know of an extension.
    """
    app.connect("builder-inited", write_pages)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
