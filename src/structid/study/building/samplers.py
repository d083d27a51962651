"""The sampler of a study, and the budget of a certified calibration."""

from __future__ import annotations

from structid.calibration.plan import Plan
from structid.core.errors import InputError, within
from structid.inference.sampling import sampler_list
from structid.inference.sampling.base import Sampler
from structid.study.building.named_kind import check_keys, kind_named
from structid.study.schema.kinds import SamplerTable
from structid.study.schema.static_tables import CalibrationTable


def build_sampler(section: SamplerTable) -> Sampler:
    """Build the sampler of a study."""
    kind = kind_named(section.kind, sampler_list.SAMPLERS)
    given = {k: v for k, v in section.model_dump(exclude={"kind"}).items() if v is not None}
    check_keys("sampler", kind.word, given, sorted(kind.keys))
    try:
        return kind.made(given)
    except InputError as error:
        key = error.where.replace(f"{kind.settings.__name__}.", "sampler.")
        raise InputError(f"key '{key}'", error.came, error.allowed, error.cure) from None


def build_plan(section: CalibrationTable | None) -> Plan | None:
    """Build the budget of a certified calibration."""
    if section is None:
        return None
    with within("table 'calibration'"):
        return Plan(**section.model_dump())
