"""Pages of the site from files in the repository's root: the changelog and what developers read."""

from __future__ import annotations

import re
from pathlib import Path

from page_file import write_page_file
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
    for name in FILES:
        text = (Path(app.srcdir).parent / name).read_text(encoding="utf-8")
        turned = _LINK.sub(lambda link: f"]({_page_of(link[1])})", text)
        write_page_file(folder / name.lower(), turned)
