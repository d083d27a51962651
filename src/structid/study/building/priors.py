"""The priors and the parameter space of a study."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from structid.core.errors import InputError, within
from structid.core.units import factor, factor_of, to_si
from structid.models import model_list
from structid.models.hysteretic.loop_lines import SMALLEST_SPREAD, LoopLines
from structid.probability import marginals
from structid.probability.space import ParameterSpace
from structid.probability.truncation import Marginal
from structid.study.building.named_kind import kind_named
from structid.study.schema.static_tables import PriorTable
from structid.study.schema.study_file import CalibrationFile

LOOP = "loop"
"""Name of a distribution that is derived from a measured loop."""

_FAMILIES: dict[str, tuple[Callable[..., Marginal], tuple[str, ...]]] = {
    "uniform": (marginals.Uniform, ("low", "high")),
    "normal": (marginals.Normal, ("mean", "sd", "low", "high")),
    "lognormal": (marginals.LogNormal, ("mean", "sd", "log_mean", "log_sd", "low", "high")),
    "gamma": (marginals.Gamma, ("mean", "sd", "shape", "rate", "low", "high")),
    "beta": (marginals.Beta, ("mean", "sd", "a", "b", "low", "high")),
    "weibull": (marginals.Weibull, ("mean", "sd", "shape", "scale", "low", "high")),
    "gumbel": (marginals.Gumbel, ("mean", "sd", "location", "scale", "low", "high")),
}
_WITH_UNIT = ("mean", "sd", "low", "high", "scale", "location")
_PURE = ("shape", "rate", "log_mean", "log_sd", "a", "b")


def prior_of(section: PriorTable, where: str, si_unit: str | None) -> Marginal:
    """Build a prior from its table."""
    if section.distribution == LOOP:
        raise InputError(
            f"key '{where}.distribution'",
            f"'{LOOP}'",
            f"a table [loop], and this prior only for {' or '.join(SMALLEST_SPREAD)}",
        )
    make, allowed = _FAMILIES[section.distribution]
    unit = (si_unit or "") if section.unit is None else section.unit
    if si_unit is not None:
        factor_of(unit, si_unit, f"key '{where}.unit'")
    values: dict[str, Any] = {}
    for name in (*_WITH_UNIT, *_PURE):
        value = getattr(section, name)
        if value is None:
            continue
        if name not in allowed:
            raise InputError(
                f"key '{where}.{name}'", f"it is given for a {section.distribution} distribution", ", ".join(allowed)
            )
        values[name] = to_si(value, unit, f"key '{where}.{name}'") / factor(unit) if name in _WITH_UNIT else value
    try:
        return make(**values, unit=unit)
    except TypeError:
        missing = [n for n in allowed[:2] if n not in values]
        raise InputError(f"key '{where}'", f"{', '.join(missing)} missing", f"{', '.join(allowed[:2])}") from None
    except InputError as error:
        raise InputError(f"key '{where}': {error.where}", error.came, error.allowed, error.cure) from None


def parameter_prior(file: CalibrationFile, name: str, loop: LoopLines | None = None) -> Marginal:
    """Build the prior of a parameter of the model."""
    base = name.rpartition("_")[0] if name.rpartition("_")[2].isdigit() else name
    kind = kind_named(file.model.type, model_list.MODELS)
    unit = None
    if kind.parameter_unit is not None:
        unit = kind.parameter_unit(base, file.model.model_dump(), (*file.parameters, *file.derived))
    section = file.parameters[name]
    if section.distribution == LOOP and loop is not None and base in SMALLEST_SPREAD:
        return _prior_of_the_loop(section, loop, name, base)
    return prior_of(section, f"parameters.{name}", unit)


def _prior_of_the_loop(section: PriorTable, loop: LoopLines, name: str, base: str) -> Marginal:
    if further := section.model_fields_set - {"distribution"}:
        raise InputError(
            f"key 'parameters.{name}.{min(further)}'",
            "it is given together with the loop",
            "no such key: the loop determines the prior",
        )
    with within(f"key 'parameters.{name}'"):
        return loop.priors()[base]


def parameter_space(file: CalibrationFile, loop: LoopLines | None = None) -> ParameterSpace:
    """Build the space of the unknown parameters of the model."""
    priors = {name: parameter_prior(file, name, loop) for name in file.parameters}
    correlation = {}
    for pair, value in file.correlation.items():
        names = [n.strip() for n in pair.split(",")]
        if len(names) != 2:
            raise InputError(f"key 'correlation.{pair}'", f"'{pair}'", 'two names, such as "stiffness, alpha" = 0.4')
        correlation[names[0], names[1]] = value
    return ParameterSpace(priors, correlation=correlation or None, derived=file.derived, coordinates=file.coordinates)


def known_or_prior(value: float | str | PriorTable | None, key: str, unit: str) -> Any:
    """Convert a parameter of the error model to a number in SI, or to a prior."""
    where = f"discrepancy.{key}"
    if value is None:
        return None
    return prior_of(value, where, unit) if isinstance(value, PriorTable) else to_si(value, unit, f"key '{where}'")
