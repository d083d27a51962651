"""A study whose hysteretic law is left to the data: ``law = "auto"``."""

from __future__ import annotations

from collections.abc import Sequence

from structid.core.errors import InputError, within
from structid.law_choice.motion_test import MotionTest
from structid.mechanics.hysteretic_laws.base import HystereticLaw
from structid.mechanics.hysteretic_laws.bilinear import Bilinear
from structid.mechanics.hysteretic_laws.law_list import LAWS
from structid.models.base import Model
from structid.models.hysteretic import hysteretic
from structid.observation import Observation
from structid.probability.space import ParameterSpace
from structid.study.schema.study_file import StudyFile
from structid.study.stages import stage_list

STAND_IN = Bilinear()
"""Law with which such a study is checked, before its law is chosen."""
OF_ONE_LAW = ("derived", "coordinates", "correlation", "loop", "campaign", "calibration")
"""Tables that need the parameters of one law."""


def law_is_open(file: StudyFile) -> bool:
    """Whether the data choose the hysteretic law."""
    if file.model.type != hysteretic.KIND.word:
        return False
    given = file.model.law  # type: ignore[attr-defined]
    return given == hysteretic.AUTO or not isinstance(given, str)


def laws_to_compare(file: StudyFile) -> list[HystereticLaw]:
    """Return the laws among which the data choose."""
    given = file.model.law  # type: ignore[attr-defined]
    return [LAWS[name]() for name in (LAWS if given == hysteretic.AUTO else given)]


def check_open_law(file: StudyFile) -> None:
    """Refuse tables that need the parameters of one law, a study without a measurement, and an empty list of laws."""
    alone = [table.word for table in stage_list.tables() if not table.needs_draws]
    given = [name for name in (*OF_ONE_LAW, *alone) if getattr(file, name, None)]
    if file.surrogate.kind != "none":
        given.append("surrogate")
    if given:
        raise InputError(
            "key 'model.law'",
            f"a choice among laws together with the table [{given[0]}], which needs the parameters of one law",
            "the name of a law",
            "Run the study without this table first; its report names the law.",
        )
    if not file.observation:
        raise InputError(
            "key 'model.law'", "a choice among laws without an [observation]", "a measurement, which shows the law"
        )
    if not laws_to_compare(file):
        raise InputError("key 'model.law'", "an empty list", "two or more laws, or 'auto'")


def motion_test_of(file: StudyFile, space: ParameterSpace, observations: Sequence[Observation]) -> MotionTest:
    """Build the test from which the law is chosen, with what the file says of the specimen."""
    check_open_law(file)
    given = file.model.model_dump(exclude={"type", "law"}, exclude_none=True)
    if both := sorted(set(given) & set(space.names)):
        raise InputError(
            f"key 'parameters.{both[0]}'", "it also has a value in [model]", "only one of the two", "Remove one."
        )
    settings = {name: given.pop(name) for name in ("mass", "damping_ratio", "damping", "substeps") if name in given}
    with within("table 'model'"):
        return MotionTest(observations, **settings, own_priors=space.marginals, values=given, name=file.name)


def with_stand_in(test: MotionTest, channels: tuple[str, ...]) -> tuple[ParameterSpace, Model]:
    """Return priors and model of the law that stands in for the open one."""
    space = test.priors(STAND_IN)
    return space, test.model(STAND_IN, space.names).recording(*channels)
