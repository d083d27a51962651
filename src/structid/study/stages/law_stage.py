"""Stage: choice of the hysteretic law from the data."""

from __future__ import annotations

from dataclasses import replace

from structid.core.streams import Purpose, derived_seed
from structid.law_choice.fit_store import FitStore
from structid.law_choice.law_comparison import ERROR_MODELS, LawComparison, compare_laws
from structid.study.stages.stage import StudyStage, StudyState, Workplace


def _run(state: StudyState, workplace: Workplace) -> StudyState:
    study = state.study
    assert study.motion_test is not None
    errors = ERROR_MODELS.get(study.file.discrepancy.kind, ERROR_MODELS["auto"])
    seed, what = derived_seed(study.file.seed, Purpose.HYSTERETIC_LAW), "choosing the hysteretic law"
    store = FitStore.of_choice(study.motion_test, study.laws, errors, seed, workplace.folder)
    with workplace.stage(what) as progress, workplace.timings.measured(what, once=True):
        comparison = compare_laws(study.motion_test, study.laws, errors, seed, store, progress)
    chosen = study.with_law(comparison.chosen.law)
    return replace(state, study=chosen, true_posterior=chosen.posterior).having(LawComparison, comparison)


STAGE = StudyStage(LawComparison, lambda state: state.study.motion_test is not None, _run)
