"""The surrogate of a study: settings from the file, fitted to the true runs, validated on others, kept in the study's folder."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

from structid.errors import InputError
from structid.models.face import Progress
from structid.runs import Runs
from structid.study.schema import SurrogateSection
from structid.surrogates.chaos.pce import PCE
from structid.surrogates.face import Surrogate
from structid.surrogates.kriging.universal_kriging import Kriging
from structid.surrogates.narx.settings import PCNARX, KrigingNARX
from structid.surrogates.pod.response_space import PODPCE, PODKriging
from structid.surrogates.storage import load_surrogate

Settings = PODKriging | PODPCE | PCNARX | KrigingNARX

KINDS: dict[str, Callable[..., Settings]] = {
    "pod_kriging": PODKriging,
    "pod_pce": PODPCE,
    "pc_narx": PCNARX,
    "kriging_narx": KrigingNARX,
}
"""Surrogates a study may name."""

_KRIGING = ("correlation", "separable", "nugget", "estimation", "trend", "shared", "starts")
_NARX = ("terms", "memories", "training", "selection", "most_terms", "horizons", "steps", "held_out", "washout")
_OWN = {
    "pod_kriging": ("left_out_energy", *_KRIGING),
    "pod_pce": ("left_out_energy", "degree", "hyperbolic_norm", "interaction", "method"),
    "pc_narx": (*_NARX, "degree"),
    "kriging_narx": (*_NARX, "degree", "refinements", *_KRIGING),
}
"""Keys that mean something for a kind, beside those that all have."""

_JOINT_ONLY = ("degree", "horizons", "steps", "refinements")
_SPARSE_ONLY = ("degree", "hyperbolic_norm", "interaction")

_COMMON = ("kind", "validation", "limit", "outside", "trust", "model_error")


def surrogate_settings(section: SurrogateSection) -> Settings:
    """Turn a section into the settings of a surrogate.

    Parameters
    ----------
    section : SurrogateSection
        What the file says.

    Returns
    -------
    PODKriging, PODPCE, PCNARX or KrigingNARX
        The settings.

    Raises
    ------
    InputError
        If a key is given that the kind does not know, or a value it does not take.
    """
    kind = section.kind
    given = {k: v for k, v in section.model_dump(exclude_unset=True).items() if k not in _COMMON and v is not None}
    for key in given:
        if key not in _OWN[kind]:
            raise InputError(
                f"key 'surrogate.{key}'", f"a key that {kind} does not know", ", ".join(sorted((*_COMMON, *_OWN[kind])))
            )
    _check_used(given)
    common = {k: getattr(section, k) for k in ("limit", "outside") if getattr(section, k) is not None}
    try:
        return _made(kind, given, common)
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


def _made(kind: str, given: dict[str, Any], common: dict[str, Any]) -> Settings:
    kriging = {k: given.pop(k) for k in _KRIGING if k in given}
    if kriging.get("trend") == "pce":
        kriging["trend"] = PCE()
    if kind == "pod_kriging":
        return PODKriging(kriging=Kriging(**kriging), **given, **common)
    if kind == "pod_pce":
        energy = {k: given.pop(k) for k in ("left_out_energy",) if k in given}
        default = PODPCE().pce if not given else PCE()
        return PODPCE(pce=dataclasses.replace(default, **given), **energy, **common)
    if kind == "pc_narx":
        return PCNARX(**given, **common)
    return KrigingNARX(kriging=dataclasses.replace(KrigingNARX().kriging, **kriging), **given, **common)


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
        Told how far the fit is.

    Returns
    -------
    Surrogate
        Fitted, not yet validated.
    """
    settings = surrogate_settings(section)
    surrogate = load_surrogate(path) if path is not None and path.is_file() else None
    # Runs that have been done again since, and have succeeded now, are worth another fit.
    stale = surrogate is None or surrogate.fitted.runs != int(runs.done.sum())
    if surrogate is None or stale:
        surrogate = settings.fit(runs, progress)
    if stale or surrogate.fitted.limit != settings.limit:
        surrogate.fitted = dataclasses.replace(surrogate.fitted, limit=settings.limit)
        if path is not None:
            surrogate.save(path)
    if section.trust:
        surrogate.trust()
    return surrogate
