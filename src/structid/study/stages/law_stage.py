"""Stage: choice of the hysteretic law from the data."""

from __future__ import annotations

from dataclasses import replace

from structid.core.streams import Purpose, derived_seed
from structid.inference.error_models.independent import IID
from structid.inference.error_models.kernels import AR1
from structid.law_choice.choose_model import by_size, fit_store
from structid.law_choice.law_comparison import LawComparison, compare_laws
from structid.study.stages.stage import StudyStage, StudyState, Workplace

ERROR_MODELS = {"iid": (IID(),), "ar1": (AR1(white=0.0),)}
"""Error models under which the laws are compared if the study names its error model; otherwise both."""


def _run(state: StudyState, workplace: Workplace) -> StudyState:
    study = state.study
    assert study.motion_test is not None
    laws = by_size(study.laws)
    errors = ERROR_MODELS.get(study.file.discrepancy.kind, (IID(), AR1(white=0.0)))
    seed, what = derived_seed(study.file.seed, Purpose.HYSTERETIC_LAW), "choosing the hysteretic law"
    store = fit_store(study.motion_test, laws, errors, seed, workplace.folder)
    with workplace.stage(what) as progress, workplace.timings.measured(what, once=True):
        comparison = compare_laws(study.motion_test, laws, errors, seed, store, progress)
    chosen = study.with_law(comparison.chosen.law)
    return replace(state, study=chosen, true_posterior=chosen.posterior).having(LawComparison, comparison)


STAGE = StudyStage(LawComparison, lambda state: state.study.motion_test is not None, _run)
