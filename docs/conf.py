"""How the site is built: `make docs`. Nothing is fetched from a network, neither while it is built nor while it is read."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import structid

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE / "_ext"))
# Pages call `structid` as a reader would.
os.environ["PATH"] = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
os.environ["PYTHONPATH"] = str(HERE / "_ext")  # the magic `%%sh` of executed pages
os.environ["COLUMNS"] = "84"

project = "structid"
author = "The structid developers"
copyright = "The structid developers"
version = release = structid.__version__

extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "myst_nb",
    "sphinx_copybutton",
    "sphinx_design",
    "formulas",
    "written_pages",
]
exclude_patterns = ["_build", "_ext", "requirements.lock"]
suppress_warnings = ["myst.header"]  # pages that are also read where they lie begin as they like

# Pages are Markdown. Those with code cells are executed, and the site is not built where one fails.
myst_enable_extensions = ["amsmath", "colon_fence", "deflist", "dollarmath", "fieldlist"]
myst_heading_anchors = 4
nb_execution_mode = "cache"
nb_execution_raise_on_error = True
nb_execution_timeout = 900
nb_execution_in_temp = True
nb_merge_streams = True

# Docstrings are numpydoc; a class's parameters are those of its constructor.
default_role = "py:obj"
autodoc_typehints = "none"
autodoc_member_order = "bysource"
autodoc_class_signature = "mixed"
autodoc_preserve_defaults = True
napoleon_google_docstring = False
napoleon_use_param = False  # types are words here, such as an array's shape, and no names to link to
napoleon_use_rtype = False

html_theme = "furo"
html_title = f"structid {release}"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_math_renderer = "mathml"
html_copy_source = False
html_show_sphinx = False
copybutton_exclude = ".linenos, .gp, .go"
