"""A study on a surrogate: any of them by one word, kept and read back, refused where it is not good enough."""

import json

import numpy as np
import pytest

from structid.campaign.runs import Runs
from structid.core.errors import InputError
from structid.study.building.surrogates import surrogate_settings
from structid.study.run import load, run_study
from structid.study.study_reader import study_file
from structid.surrogates import surrogate_list as registry
from structid.surrogates.base import Surrogate
from structid.surrogates.chaos.pce import PCE
from studies import PACKAGED, PLAIN, shortened, without_pages

STUDY = (
    shortened(PLAIN)
    .replace("steps = 3000", "steps = 30\nstart_candidates = 1\nsettling_steps = 0")
    .replace('methods = ["pattern_search", "interior_point"]\nstarts = 4', "methods = []")
    .replace("[discrepancy]", "[campaign]\nruns = 80\n\n[discrepancy]")
)

KINDS = [kind.word for kind in registry.KINDS if kind.word]


def words(kind, more=""):
    return STUDY.replace('kind = "none"', f'kind = "{kind}"\nvalidation = 20\nlimit = 0.5\n{more}')


def written(folder, text, name="study.toml"):
    (folder / name).write_text(text)
    return folder / name


def test_the_packaged_study_names_every_kind():
    assert all(kind in PACKAGED for kind in KINDS)


# The others take half a minute each: they are among the slow ones.
@pytest.mark.parametrize("kind", [k if k == "pod_kriging" else pytest.param(k, marks=pytest.mark.slow) for k in KINDS])
def test_the_study_runs_with_each_of_them_by_one_word(kind, tmp_path):
    more = "degree = 2\nsteps = 4\n" if "narx" in kind else ""
    study = written(tmp_path, words(kind, more))
    outcome = run_study(study, tmp_path / "out")
    assert outcome.results[Surrogate].validation is not None and len(outcome.results[Surrogate].validation.errors) == 20
    assert outcome.result.target.model is outcome.results[Surrogate]
    page = outcome.report.read_text()
    assert 'id="surrogate"' in page and "Validation" in page and "surrogate_velocity" in page
    assert len(outcome.results[Runs]) == 80 and (tmp_path / "out" / "validation.h5").is_file()
    timings = json.loads((tmp_path / "out" / "timings.json").read_text())
    assert {"model runs", "fitting the surrogate", "sampling"} <= set(timings)
    # Everything is read back: nothing is fitted or drawn again.
    with without_pages():
        again = run_study(study, tmp_path / "out", resume=True)
    np.testing.assert_array_equal(again.result.history, outcome.result.history)
    assert again.results[Surrogate].content_hash == outcome.results[Surrogate].content_hash


def test_runs_and_a_surrogate_of_them_without_a_measurement(tmp_path):
    text = words("pod_kriging")
    study = written(
        tmp_path, text[: text.index("[observation]")] + text[text.index("[surrogate]") : text.index("[discrepancy]")]
    )
    outcome = run_study(study, tmp_path / "out")
    assert outcome.result is None and outcome.results[Surrogate].validation.mean < 0.5
    assert "surrogate_velocity" in outcome.report.read_text()


def test_a_surrogate_past_its_limit_is_not_sampled(tmp_path):
    study = written(tmp_path, words("pod_pce").replace("limit = 0.5", "limit = 1e-9"))
    with pytest.raises(InputError, match=r"PODPCE in a posterior: a mean relative error of .*trust\(\)"):
        run_study(study, tmp_path / "out")
    assert not (tmp_path / "out" / "chains.h5").exists()
    # Its validation can be looked at.
    assert "surrogate_velocity" in (tmp_path / "out" / "report.html").read_text()


@pytest.mark.slow
def test_a_surrogate_past_its_limit_is_sampled_by_who_trusts_it_or_raises_the_limit(tmp_path):
    """Model runs and fit are kept for them."""
    with pytest.raises(InputError, match="PODPCE in a posterior"):
        run_study(written(tmp_path, words("pod_pce").replace("limit = 0.5", "limit = 1e-9")), tmp_path / "out")
    trusted = written(tmp_path, words("pod_pce", "trust = true").replace("limit = 0.5", "limit = 1e-9"))
    assert run_study(trusted, tmp_path / "out", resume=True).result is not None
    raised = written(tmp_path, words("pod_pce"), "raised.toml")
    assert run_study(raised, tmp_path / "out", resume=True).results[Surrogate].fitted.limit == 0.5


@pytest.mark.parametrize(
    ("more", "words_of_the_error"),
    [
        ("terms = ['y(t-1)']", "key 'surrogate.terms': a key that pod_kriging does not have.*left_out_energy"),
        ("correlation = 'cubic'", "surrogate.correlation.*'cubic'.*matern52"),
        ("nugget = -1.0", "surrogate.*nugget"),
        ("left_out_energy = 2.0", "surrogate.*left_out_energy.*below 1"),
        ("degre = 3", "unknown key.*'degree'"),
        ("type = 'pod_pce'", "surrogate.type.*an unknown key"),
    ],
)
def test_a_mistake_in_the_table(more, words_of_the_error, tmp_path):
    with pytest.raises(InputError, match=words_of_the_error):
        load(written(tmp_path, words("pod_kriging", more)))


@pytest.mark.parametrize(
    ("kind", "more", "words_of_the_error"),
    [
        ("pc_narx", "degree = 4", r"72 runs.*degree 4.*at least 140 runs"),
        ("pc_narx", "training = 'per-experiment'\ndegree = 2", "surrogate.degree.*does not use it"),
        ("pod_pce", "method = 'shrinkage'\ndegree = 2", "surrogate.degree.*does not use it"),
        ("kriging_narx", "horizons = [0]", "horizons.*1 or more"),
        ("pod_pce", "method = 'ols'\ndegree = 9", "80 runs for a basis of .* terms"),
        ("none", "degree = 3", "surrogate.degree.*kind = 'none'"),
        ("pc_narx", "terms = {acceleration = ['x(t)']}", "acceleration.*velocity"),
    ],
)
def test_what_fitting_would_refuse_is_said_before_any_run(kind, more, words_of_the_error, tmp_path):
    with pytest.raises(InputError, match=words_of_the_error):
        load(written(tmp_path, words(kind, more)))


def test_settings_reach_the_surrogate():
    section = study_file().model_fields["surrogate"].annotation
    settings = surrogate_settings(
        section(kind="kriging_narx", degree=2, correlation="matern32", terms=("x(t)", "y(t-1)"))
    )
    assert settings.degree == 2 and settings.kriging.correlation == "matern32" and settings.terms == ("x(t)", "y(t-1)")
    assert settings.kriging.nugget == "estimate"
    further = surrogate_settings(
        section(kind="pc_narx", washout=2.0, horizons=(4, 16), terms={"velocity": ("x(t)", "y(t-1)")})
    )
    assert further.washout == 2.0 and further.horizons == (4, 16) and further.terms["velocity"] == ("x(t)", "y(t-1)")
    kriging = surrogate_settings(section(kind="pod_kriging", starts=3, trend="pce")).kriging
    assert kriging.starts == 3 and isinstance(kriging.trend, PCE)
    assert surrogate_settings(section(kind="pod_pce", degree=4)).pce.method == "sparse"
    assert surrogate_settings(section(kind="pod_pce")).pce.method == "shrinkage"
