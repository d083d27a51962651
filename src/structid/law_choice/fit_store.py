"""Fitted laws on disk: an interrupted choice continues from them, and a report needs no new fits."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from structid.core.journal import Journal
from structid.inference.error_models.base import ErrorModel
from structid.law_choice.cyclic_test import CyclicTest
from structid.law_choice.law_fit import LawFit
from structid.mechanics.hysteretic_laws.base import HystereticLaw
from structid.optimize.many_starts import Minimum

SCHEMA = 1
"""Version of the layout."""


class FitStore:
    """Minima of laws by name and number of samples, in a journal; without a path, nothing is kept."""

    def __init__(self, path: Path | None, identity: Mapping[str, Any]) -> None:
        self._journal = None if path is None else Journal(path, {"schema": SCHEMA, **identity})
        self._known = {str(entry["key"]): entry for entry in self._journal or ()}

    def minima(self, law: HystereticLaw, test: CyclicTest, search: Callable[[], list[Minimum]]) -> list[Minimum]:
        """Return the stored minima of a search, or search."""
        key = f"{law.word}, {len(test.force)} samples: search"
        if key not in self._known:
            minima = search()
            self._keep(key, minima, [0.0] * len(minima))
            return minima
        return _minima_of(self._known[key])

    def fits(
        self,
        law: HystereticLaw,
        test: CyclicTest,
        error_models: Sequence[ErrorModel],
        refine: Callable[[], list[LawFit]],
    ) -> list[LawFit]:
        """Return the stored fits of a law under every error model, or fit it."""
        key = f"{law.word}, {len(test.force)} samples: fits"
        if key not in self._known:
            fits = refine()
            self._keep(key, [fit.minimum for fit in fits], [fit.correlation for fit in fits])
            return fits
        entry = self._known[key]
        stored = zip(_minima_of(entry), entry["correlation"], strict=True)
        return [
            LawFit(law, test, errors, minimum, float(correlation))
            for errors, (minimum, correlation) in zip(error_models, stored, strict=False)
        ]

    def _keep(self, key: str, minima: list[Minimum], correlations: list[float]) -> None:
        if self._journal is None:
            return
        self._journal.append(
            {
                "key": np.array(key),
                "correlation": np.array(correlations),
                **{name: np.array([getattr(m, name) for m in minima]) for name in Minimum.__dataclass_fields__},
            }
        )


def _minima_of(entry: Mapping[str, np.ndarray]) -> list[Minimum]:
    """Return the minima of one entry."""
    values = zip(entry["x"], entry["value"], entry["mean_square"], entry["curvature"], strict=True)
    return [Minimum(x, float(value), float(square), curvature) for x, value, square, curvature in values]
