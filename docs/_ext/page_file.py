"""A page that is written when the site is built."""

from __future__ import annotations

from pathlib import Path


def write_page_file(path: Path, content: str) -> None:
    """Write a page unless it is there already, so that it is not read anew.

    Parameters
    ----------
    path : Path
        Its file.
    content : str
        Its text.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    if not path.is_file() or path.read_text(encoding="utf-8") != content:
        path.write_text(content, encoding="utf-8")
