"""Example studies in the package."""

from __future__ import annotations

from importlib import resources

STUDIES = ("measured", "bouc_wen", "shear_frame", "facade", "external")
"""Studies for `structid run`."""

PROGRAMMES = ("hybrid", "hybrid_facade")
"""Programmes of hybrid tests for `structid hybrid`."""

TEMPLATES = (*STUDIES, *PROGRAMMES)
"""Names of all example studies."""

SOLVERS = {"external": "external_solver.py"}
"""Additional file of an example study."""


def template(name: str) -> str:
    """Text of an example study, or of its solver."""
    file = f"{name}.toml" if name in TEMPLATES else name
    return (resources.files("structid") / "study" / "templates" / file).read_text(encoding="utf-8")
