"""Studies shipped with the package."""

from __future__ import annotations

from importlib import resources

STUDIES = ("measured", "bouc_wen", "shear_frame", "facade", "external")
"""Calibrations, for `structid run`."""

PROGRAMMES = ("hybrid", "hybrid_facade")
"""Programmes of hybrid tests, for `structid hybrid`."""

TEMPLATES = (*STUDIES, *PROGRAMMES)
"""All names."""

SOLVERS = {"external": "external_solver.py"}
"""Additional files of a packaged study."""


def template(name: str) -> str:
    """Text of a packaged study, or of its solver."""
    file = f"{name}.toml" if name in TEMPLATES else name
    return (resources.files("structid") / "study" / "templates" / file).read_text(encoding="utf-8")
