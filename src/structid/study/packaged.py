"""Example studies in the package."""

from __future__ import annotations

from importlib import resources

CYCLIC_TESTS = ("cyclic",)
"""Studies of cyclic tests for `structid run`."""

STUDIES = ("measured", "bouc_wen", "shear_frame", "facade", "external")
"""Studies for `structid run`."""

PROGRAMMES = ("hybrid", "hybrid_facade")
"""Programmes of hybrid tests for `structid hybrid`."""

TEMPLATES = (*STUDIES, *CYCLIC_TESTS, *PROGRAMMES)
"""Names of all example studies."""

SOLVERS = {"external": "external_solver.py"}
"""Solver files of example studies, by study name."""


def template(name: str) -> str:
    """Content of an example study file, or of its solver file."""
    file = f"{name}.toml" if name in TEMPLATES else name
    return (resources.files("structid") / "study" / "templates" / file).read_text(encoding="utf-8")
