"""Deterministic calibration: minimise a misfit within bounds and linear inequalities from many starting points."""

from __future__ import annotations

from structid.optimize.interior_point import interior_point
from structid.optimize.minima import Minimum, OptimizeResult
from structid.optimize.pattern_search import pattern_search

__all__ = ["Minimum", "OptimizeResult", "interior_point", "pattern_search"]
