"""The surrogate of a study: its settings from the file, and its fit to model runs."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from structid.campaign.runs import Runs
from structid.core.errors import InputError, within
from structid.core.progress import Progress
from structid.study.building.named_kind import check_keys, kind_named
from structid.study.schema.kinds import SurrogateTable
from structid.surrogates import surrogate_list as registry
from structid.surrogates.base import Surrogate, SurrogateSettings
from structid.surrogates.surrogate_kind import SurrogateKind

_COMMON = ("kind", "validation", "limit", "outside", "trust", "model_error")


def surrogate_settings(section: SurrogateTable) -> SurrogateSettings:
    """Convert a table to the settings of a surrogate."""
    kind = kind_named(section.kind, registry.KINDS)
    given = {k: v for k, v in section.model_dump(exclude_unset=True).items() if k not in _COMMON and v is not None}
    check_keys("surrogate", kind.word, given, sorted((*_COMMON, *kind.keys)))
    _check_used(given, kind)
    common = {k: getattr(section, k) for k in ("limit", "outside") if getattr(section, k) is not None}
    with within("table 'surrogate'"):
        return kind.made({**given, **common})


def _check_used(given: Mapping[str, Any], kind: SurrogateKind) -> None:
    """Reject keys that have no effect because of another key."""
    for (switch, value), unused in kind.unused.items():
        for key in unused:
            if given.get(switch) == value and key in given:
                raise InputError(
                    f"key 'surrogate.{key}'",
                    f"it is given with {switch} = '{value}', which does not use it",
                    f"no {', '.join(unused)}, or another {switch}",
                )


def fitted_surrogate(section: SurrogateTable, runs: Runs, path: Path | None, progress: Progress | None) -> Surrogate:
    """Fit the surrogate, or read a stored fit."""
    settings = surrogate_settings(section)
    surrogate = registry.load_surrogate(path) if path is not None and path.is_file() else None
    # Fit again if failed runs have been repeated successfully.
    stale = surrogate is None or surrogate.fitted.runs != int(runs.done.sum())
    if surrogate is None or stale:
        surrogate = settings.fit(runs, progress)
    if stale or surrogate.fitted.limit != settings.limit:
        surrogate = surrogate.with_limit(settings.limit)
        if path is not None:
            surrogate.save(path)
    if section.trust:
        surrogate.trust()
    return surrogate
