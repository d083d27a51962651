"""A study with a [calibration]: certificate first on the page and in the exit code, resumed, refused."""

import json

import numpy as np
import pytest

from commands import structid
from structid.calibration import final_draws
from structid.calibration.calibration_result import CalibrationResult
from structid.core.errors import InputError
from structid.study.run import load, report_again, run_study
from structid.surrogates.base import Surrogate
from studies import PLAIN, shortened

STUDY = shortened(PLAIN).replace('methods = ["pattern_search", "interior_point"]\nstarts = 4', "methods = []")
HEAD, TAIL = STUDY[: STUDY.index("[sampler]")], STUDY[STUDY.index("[deterministic]") :]
CALIBRATION = "[calibration]\ntrue_runs = 300\nstart = 40\nbatch = 20\ncertificate = 100\n\n"
SAMPLER = '[sampler]\nkind = "smc"\nparticles = 100\nsteps = 20\neffective_share = 0.5\ncorrelation = 0.5\n\n'


def written(folder, calibration=CALIBRATION, surrogate='kind = "pod_kriging"', sampler=SAMPLER):
    text = HEAD.replace('kind = "none"', surrogate) + calibration + sampler + TAIL
    (folder / "study.toml").write_text(text)
    return folder / "study.toml"


@pytest.mark.slow
def test_a_certified_study(tmp_path, monkeypatch):
    # One good surrogate in fifty is refused by the luck of its draws; the budget is for a second certificate, and a third.
    study = written(tmp_path, CALIBRATION.replace("true_runs = 300", "true_runs = 700"))
    outcome = run_study(study, tmp_path / "out")
    certificate = outcome.results[CalibrationResult].certificate
    assert certificate.certified and outcome.trusted and outcome.result.verdict().converged, str(
        outcome.results[CalibrationResult]
    )
    page = outcome.report.read_text()
    assert page.index("Certified: surrogate and model agree") < page.index('id="posterior-table"')
    assert 'id="calibration"' in page and "Rounds" in page and "sd of log weights" in page
    assert "the surrogate's error (" not in page  # what is certified needs no warning
    # First of all the answers: what the parameters are, whether to believe them, what next.
    head = page.index('<section class="page-summary')
    assert head < page.index("What are the parameters?") < page.index("certified by") < page.index("What next?")
    assert page.index("What next?") < page.index('id="verdict"')
    monkeypatch.setattr(final_draws, "check_representation", None)  # what the second explorer has found is stored
    again = report_again(tmp_path / "out")
    np.testing.assert_array_equal(again.result.history, outcome.result.history)
    assert str(again.results[CalibrationResult].representation) == str(
        outcome.results[CalibrationResult].representation
    )
    assert again.report.read_text().count("<figure>") == page.count("<figure>")


@pytest.mark.slow
def test_a_study_that_is_not_certified_says_so_and_goes_on_with_more_runs(tmp_path):
    """A surrogate far too smooth, and no budget to make it better; what rests on it is done again with the next one."""
    budget = CALIBRATION.replace("true_runs = 300", "true_runs = 160")
    too_smooth = 'kind = "pod_kriging"\nnugget = 0.5\ncorrelation = "gaussian"'
    study = written(tmp_path, budget, too_smooth)
    searched = study.read_text().replace("methods = []", 'methods = ["interior_point"]\nstarts = 2')
    study.write_text(searched)
    done = structid("run", study, "--out", "out", cwd=tmp_path)
    assert done.returncode == 3, done.stderr
    page = (tmp_path / "out" / "report.html").read_text()
    assert "Not to be trusted: do not use these numbers" in page or "Usable with re-weighting" in page
    assert "160 runs" in structid("runs", "out", cwd=tmp_path).stdout
    first = json.loads((tmp_path / "out" / "interior_point.json").read_text())
    study.write_text(searched.replace("true_runs = 160", "true_runs = 300"))
    outcome = run_study(study, tmp_path / "out", resume=True)
    second = json.loads((tmp_path / "out" / "interior_point.json").read_text())
    assert outcome.results[CalibrationResult].training_runs > 160 and second["settings"] != first["settings"]
    fitted = outcome.results[Surrogate].fitted
    for search in (first, second):  # the posterior lies on a bound of the prior, which no run of a design quite reaches
        ends = np.array([m["theta"] for m in search["minima"]])
        assert (ends <= load(study).space.bounds[:, 1]).all()
    assert (ends >= fitted.low).all() and (ends <= fitted.high).all()


@pytest.mark.slow
def test_exact_sampling_needs_no_certificate(tmp_path):
    """A surrogate of a small budget proposes, the model decides: the draws are the model's, whatever the certificate says."""
    budget = CALIBRATION.replace("true_runs = 300", "true_runs = 160")
    exact = '[sampler]\nkind = "delayed_acceptance"\nwalkers = 24\nsteps = 30\ntuning = 8\n\n'
    outcome = run_study(written(tmp_path, budget, sampler=exact), tmp_path / "out")
    calibration, result = outcome.results[CalibrationResult], outcome.result
    assert calibration.exact and not calibration.reweighted
    assert calibration.trusted == outcome.trusted == result.verdict().converged
    assert type(result.target.model).__name__ == "BoucWen" and result.cost.true_runs == 30 * 24 * 4
    page = outcome.report.read_text()
    # A chain that has not converged is nobody's posterior yet.
    head = (
        "Exact: the draws come from the posterior of the model"
        if outcome.trusted
        else "Exact in the long run, but the chain has not yet converged"
    )
    assert page.index(head) < page.index('id="posterior-table"')
    assert str(result.cost.true_runs) in page.replace(",", "")
    again = run_study(tmp_path / "study.toml", tmp_path / "out", resume=True)
    np.testing.assert_array_equal(again.result.history, result.history)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (dict(surrogate='kind = "none"'), "calibration.*a surrogate such as"),
        (dict(surrogate='kind = "pod_kriging"\nlimit = 0.1'), "surrogate.limit.*the certificate assesses"),
        (dict(calibration=CALIBRATION + "[campaign]\nruns = 50\n\n"), "a calibration plans its own runs"),
        (dict(calibration=CALIBRATION.replace("300", "30")), "calibration.*or more"),
        (dict(sampler='[sampler]\nkind = "smc"\nwalkers = 40\n\n'), "sampler.walkers.*smc does not have"),
        (dict(sampler="[sampler]\nparticles = 40\n\n"), "sampler.particles.*aies does not have"),
        (dict(surrogate='kind = "pc_narx"\ndegree = 5'), "40 runs|36 runs"),
        (dict(surrogate='kind = "pod_kriging"\nmodel_error = true'), "surrogate.model_error.*the certificate assesses"),
        (dict(sampler='[sampler]\nkind = "delayed_acceptance"\ntuning = 90\n\n'), "sampler.tuning.*discarded"),
        (dict(sampler='[sampler]\nkind = "nuts"\nwalkers = 40\n\n'), "sampler.walkers.*nuts does not have"),
        (
            dict(surrogate='kind = "none"', calibration="", sampler='[sampler]\nkind = "delayed_acceptance"\n\n'),
            "delayed_acceptance' without a .surrogate.",
        ),
    ],
)
def test_tables_that_do_not_fit_together(change, words, tmp_path):
    with pytest.raises(InputError, match=words):
        load(written(tmp_path, **change))
