"""Fitted laws, in memory and on disk: an interrupted choice continues from them, and a report needs no new fits."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from structid.core.hashing import digest
from structid.core.journal import Journal
from structid.inference.error_models.base import ErrorModel
from structid.law_choice.law_fit import LawFit
from structid.law_choice.specimen_test import SpecimenTest
from structid.mechanics.hysteretic_laws.base import HystereticLaw
from structid.optimize.many_starts import Minimum

SCHEMA = 2
"""Version of the layout."""


FITS = "laws.journal"
"""File of the fitted laws in a folder."""


def by_size(laws: Sequence[HystereticLaw]) -> list[HystereticLaw]:
    """Return laws in the order of their number of parameters."""
    return sorted(laws, key=lambda law: len(law.parameters()))


class FitStore:
    """Minima of laws by name and number of measured values, in a journal if there is a path."""

    def __init__(self, path: Path | None, identity: Mapping[str, Any]) -> None:
        self._journal = None if path is None else Journal(path, {"schema": SCHEMA, **identity})
        self._known = {str(entry["key"]): entry for entry in self._journal or ()}

    @classmethod
    def of_choice(
        cls,
        test: SpecimenTest,
        laws: Sequence[HystereticLaw],
        error_models: Sequence[ErrorModel],
        seed: int,
        folder: str | os.PathLike[str] | None,
    ) -> FitStore:
        """Return the store of the fits of laws to a test, in a folder if there is one."""
        identity = {
            "test": test.content_hash,
            "laws": [f"{law.word} {digest([asdict(law), test.priors(law).content_hash])}" for law in by_size(laws)],
            "error_models": digest([errors.describe() for errors in error_models]),
            "seed": seed,
        }
        return cls(None if folder is None else Path(folder) / FITS, identity)

    def minima(self, law: HystereticLaw, test: SpecimenTest, search: Callable[[], list[Minimum]]) -> list[Minimum]:
        """Return the stored minima of a search, or search."""
        key = f"{law.word}, {len(test.scales)} values: search"
        if key not in self._known:
            minima = search()
            self._keep(key, minima, [(0.0,)] * len(minima))
            return minima
        return _minima_of(self._known[key])

    def fits(
        self,
        law: HystereticLaw,
        test: SpecimenTest,
        error_models: Sequence[ErrorModel],
        refine: Callable[[], list[LawFit]],
    ) -> list[LawFit]:
        """Return the stored fits of a law under every error model, or fit it."""
        key = f"{law.word}, {len(test.scales)} values: fits"
        if key not in self._known:
            fits = refine()
            self._keep(key, [fit.minimum for fit in fits], [fit.correlations for fit in fits])
            return fits
        entry = self._known[key]
        stored = zip(_minima_of(entry), entry["correlations"], strict=True)
        return [
            LawFit(law, test, errors, minimum, tuple(map(float, correlations)))
            for errors, (minimum, correlations) in zip(error_models, stored, strict=False)
        ]

    def _keep(self, key: str, minima: list[Minimum], correlations: list[tuple[float, ...]]) -> None:
        entry = {
            "key": np.array(key),
            "correlations": np.array(correlations),
            **{name: np.array([getattr(m, name) for m in minima]) for name in Minimum.__dataclass_fields__},
        }
        self._known[key] = entry
        if self._journal is not None:
            self._journal.append(entry)


def _minima_of(entry: Mapping[str, np.ndarray]) -> list[Minimum]:
    """Return the minima of one entry."""
    values = zip(entry["x"], entry["value"], entry["mean_squares"], entry["curvature"], strict=True)
    return [Minimum(x, float(value), squares, curvature) for x, value, squares, curvature in values]
