"""The surrogate of a study: settings from the words of the file, and the fit to its true runs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from structid.errors import InputError
from structid.models.face import Progress
from structid.runs import Runs
from structid.study.schema.kinds import SurrogateSection
from structid.surrogates.face import Surrogate, SurrogateSettings
from structid.surrogates.registry import by_word, load_surrogate

_JOINT_ONLY = ("degree", "horizons", "steps", "refinements")
_SPARSE_ONLY = ("degree", "hyperbolic_norm", "interaction")

_COMMON = ("kind", "validation", "limit", "outside", "trust", "model_error")


def surrogate_settings(section: SurrogateSection) -> SurrogateSettings:
    """Turn a section into the settings of a surrogate.

    Parameters
    ----------
    section : SurrogateSection
        What the file says.

    Returns
    -------
    SurrogateSettings
        Of its kind.

    Raises
    ------
    InputError
        If the kind does not know a key, or does not take a value.
    """
    kind = by_word()[section.kind]
    given = {k: v for k, v in section.model_dump(exclude_unset=True).items() if k not in _COMMON and v is not None}
    for key in given:
        if key not in kind.keys:
            raise InputError(
                f"key 'surrogate.{key}'",
                f"a key that {kind.word} does not know",
                ", ".join(sorted((*_COMMON, *kind.keys))),
            )
    _check_used(given)
    common = {k: getattr(section, k) for k in ("limit", "outside") if getattr(section, k) is not None}
    try:
        return kind.made({**given, **common})
    except InputError as error:
        raise InputError(f"table 'surrogate': {error.where}", error.came, error.allowed, error.cure) from None


def _check_used(given: dict[str, Any]) -> None:
    """Refuse keys that another one makes meaningless: nobody should wonder why they change nothing."""
    for switch, value, unused in (
        ("training", "per-experiment", _JOINT_ONLY),
        ("method", "shrinkage", _SPARSE_ONLY),
    ):
        for key in unused:
            if given.get(switch) == value and key in given:
                raise InputError(
                    f"key 'surrogate.{key}'", f"it is given with {switch} = '{value}', which does not use it",
                    f"one of the two: without {', '.join(unused)}, or another {switch}",
                )  # fmt: skip


def fitted_surrogate(section: SurrogateSection, runs: Runs, path: Path | None, progress: Progress | None) -> Surrogate:
    """Fit the surrogate, or read the one that was fitted before.

    Parameters
    ----------
    section : SurrogateSection
        What the file says.
    runs : Runs
        The true runs.
    path : Path or None
        Where it is kept, if anywhere.
    progress : callable or None
        Called with the percentage of the fit that is done, and 100.

    Returns
    -------
    Surrogate
        Fitted, not yet validated.
    """
    settings = surrogate_settings(section)
    surrogate = load_surrogate(path) if path is not None and path.is_file() else None
    # Failed runs that have been repeated since, and have now succeeded, are worth another fit.
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
