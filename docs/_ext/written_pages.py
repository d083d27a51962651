"""Pages that are written when the building begins: commands, laws, public names, study keys, and pages of the repository's root."""

from __future__ import annotations

from typing import Any

import law_gallery
import project_pages
import public_names
import study_keys
from sphinx.application import Sphinx

import commands


def setup(app: Sphinx) -> dict[str, Any]:
    """Write all of them before anything is read.

    Parameters
    ----------
    app : Sphinx
        The application.

    Returns
    -------
    dict
        What Sphinx wants to know of an extension.
    """
    for write in (
        commands.write_page,
        law_gallery.write_page,
        project_pages.write_pages,
        public_names.write_pages,
        study_keys.write_page,
    ):
        app.connect("builder-inited", write)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
