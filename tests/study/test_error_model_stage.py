"""Studies that leave the error model to the data: on the model, on a surrogate, in a certified calibration."""

import gc
from dataclasses import replace

import numpy as np
import pytest

from structid.calibration.calibration_result import CalibrationResult
from structid.core.hashing import digest
from structid.inference.error_model_choice import ErrorModelChoice
from structid.study.run import load, report_again, run_study
from structid.study.stages import error_model_stage
from studies import PACKAGED, SMALL, shortened, without_pages

OPEN = SMALL.replace('kind = "iid"', 'kind = "auto"')
HEAD, TAIL = OPEN[: OPEN.index("[sampler]")], OPEN[OPEN.index("[deterministic]") :]


def written(folder, text):
    (folder / "study.toml").write_text(text)
    return folder / "study.toml"


@pytest.mark.slow
def test_a_model_that_is_wrong_drifts_and_the_page_says_so(tmp_path, monkeypatch):
    # A fifth of the usual draws: those of tens of hidden values take 150 MB, several times over.
    fewer = replace(error_model_stage.WITH_HIDDEN_VALUES, steps=50)
    monkeypatch.setattr(error_model_stage, "WITH_HIDDEN_VALUES", fewer)
    study = written(tmp_path, HEAD + TAIL)
    outcome = run_study(study, tmp_path / "out")
    choice, result = outcome.results[ErrorModelChoice], outcome.result
    assert choice.error_models == (
        "iid",
        "ar1",
        "damped cosine",
        "drifting parameters + iid",
        "drifting parameters + damped cosine",
    )
    best = max(range(5), key=lambda place: choice.evidences[place].value)
    assert "drifting" in choice.error_models[best]
    # Tens of hidden values need another sampler than the four parameters of the file. If they are not sampled well, they are left.
    assert result.target.error_model.inside is not choice.added_only
    assert result.verdict().wrong_model or not result.verdict().converged, str(result.verdict())
    page = outcome.report.read_text()
    assert choice.sentence in page
    for law in choice.error_models:
        assert law in page
    said = "The model is wrong for these data" if result.verdict().converged else "The sampler has not converged"
    assert page.count(said) >= 4  # at the top, and beside what it concerns
    # The draws of tens of hidden values are large: they are compared by their hash, and not held twice.
    sentence, history = choice.sentence, digest(result.history)
    del outcome, result, choice
    gc.collect()
    with without_pages():
        again = report_again(tmp_path / "out")
    assert digest(again.result.history) == history
    assert again.results[ErrorModelChoice].sentence == sentence


@pytest.mark.slow
def test_a_certified_calibration_chooses_once_its_surrogate_is_good(tmp_path):
    text = shortened(PACKAGED).replace('kind = "iid"', 'kind = "auto"').replace("true_runs = 500", "true_runs = 700")
    text = text.replace(
        'kind = "smc"', 'kind = "smc"\nparticles = 100\nsteps = 20\neffective_share = 0.5\ncorrelation = 0.5\n#'
    )
    with without_pages():
        outcome = run_study(written(tmp_path, text), tmp_path / "out")
        again = run_study(tmp_path / "study.toml", tmp_path / "out", resume=True)
    choice, calibration = outcome.results[ErrorModelChoice], outcome.results[CalibrationResult]
    assert choice is calibration.error_model_choice and choice.error_models[0] == "iid"
    assert choice.error_models[-2:] == (
        "ar1",
        "damped cosine",
    )  # and before them what heavy tails and uneven errors call for
    law = choice.posterior.error_model.describe()["kind"]
    assert (
        law != "iid"
        and calibration.posterior.error_model.describe()["kind"]
        == law
        == outcome.result.target.error_model.describe()["kind"]
    )
    assert calibration.certificate.names == calibration.posterior.compared_names
    np.testing.assert_array_equal(again.result.history, outcome.result.history)
    assert again.results[ErrorModelChoice].evidences[0].value == choice.evidences[0].value


def test_a_law_left_open_is_another_study_than_any_law(tmp_path):
    identities = {load(written(tmp_path, text)).identity["discrepancy"] for text in (OPEN, SMALL)}
    assert len(identities) == 2
    assert "auto" in identities
