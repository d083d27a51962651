"""Comparison of model classes: stretches left out against refitted answers, Bayes factors, studies side by side."""

import json
import shutil

import numpy as np
import pytest
import scipy.stats

import structid as si
from structid import cli
from structid.errors import InputError
from structid.inference.assessment.comparison import Comparison, LeaveOut, ModelClass, leave_out
from structid.inference.sampling.sampler import Evidence
from structid.study.compare import compare_studies
from structid.study.replicas import check_by_simulation
from structid.study.run import run_study
from studies import PACKAGED, PLAIN, shortened


class Line(si.BoucWen):
    """y = a x(t): a linear model in a posterior's clothes, so that everything has a closed form."""

    def __init__(self, regressor):
        super().__init__(mass=1.0, damping_ratio=0.0, beta=0.0, gamma=0.0, alpha=1.0, free=("stiffness",), substeps=1)
        self.regressor = regressor

    def response(self, theta, excitation, stages):
        from structid.device import jnp

        return jnp.asarray(self.regressor)[:, None, None] * theta[None, None, :, 0], jnp.ones(len(theta), dtype=bool)


def test_stretches_left_out_as_by_fitting_again():
    rng = np.random.default_rng(1)
    samples, noise, prior = 200, 0.5, 2.0
    x = rng.normal(size=samples)
    y = 1.3 * x + noise * rng.normal(size=samples)
    record = si.GroundMotion(np.ones(samples), 0.01)
    space = si.ParameterSpace(stiffness=si.Normal(0.0, prior))
    posterior = si.Posterior(space, Line(x), si.Observation(record, y), si.IID(variance=noise**2))

    def conditioned(rows):
        precision = (x[rows] ** 2).sum() / noise**2 + 1.0 / prior**2
        return (x[rows] @ y[rows]) / noise**2 / precision, 1.0 / precision

    mean, variance = conditioned(np.arange(samples))
    draws = mean + np.sqrt(variance) * rng.normal(size=(4000, 1))
    found = leave_out(posterior, draws, blocks=20)
    for block, value in zip(np.arange(samples).reshape(20, 10), found.each, strict=True):
        mean, variance = conditioned(np.setdiff1d(np.arange(samples), block))
        covariance = noise**2 * np.eye(10) + variance * np.outer(x[block], x[block])
        expected = scipy.stats.multivariate_normal(mean * x[block], covariance).logpdf(y[block])
        assert value == pytest.approx(expected, abs=0.05)
    assert found.unreliable == 0 and found.value == pytest.approx(found.each.sum())
    with pytest.raises(InputError, match="blocks"):
        leave_out(posterior, draws, blocks=500)


def one(name, value, error=0.1, each=None, trusted=True):
    evidence = None if value is None else Evidence(value, error, np.array([value]))
    each = np.zeros(10) if each is None else each
    return ModelClass(name, evidence, LeaveOut(each, np.zeros(10)), 3, 0.1, 0.9, trusted)


def test_bayes_factors_and_probabilities():
    found = Comparison((one("a", -10.0), one("b", -12.0), one("c", -30.0)))
    assert found.best.name == "a" and found.bayes_factor(found.classes[1]) == (-2.0, pytest.approx(0.1414, abs=1e-3))
    np.testing.assert_allclose(found.probabilities, scipy.special.softmax([-10.0, -12.0, -30.0]))
    assert "leans to a" in found.verdict and "b" in found.verdict
    assert "decides for a" in Comparison((one("a", 0.0), one("b", -50.0))).verdict
    assert "cannot choose" in Comparison((one("a", 0.0), one("b", -0.1))).verdict
    assert "Not to be relied on: b" in Comparison((one("a", 0.0), one("b", -9.0, trusted=False))).verdict
    heads, rows = found.rows()
    assert [r[0] for r in rows] == ["a", "b", "c"] and all(len(r) == len(heads) for r in rows)
    assert found.side_by_side()[0] == ["", "a", "b", "c"]


def test_without_evidence_what_is_left_out_decides():
    better = one("b", None, each=np.linspace(1.0, 2.0, 10))
    found = Comparison((one("a", -1.0), better))
    assert found.best is better and "predicts best" in found.verdict and np.isnan(found.probabilities).all()
    gap, error = found.classes[0].left_out.less(better.left_out)
    assert gap == pytest.approx(-15.0) and error == pytest.approx(np.sqrt(10 * np.linspace(1, 2, 10).var(ddof=1)))


QUICK = '[sampler]\nkind = "smc"\nparticles = 100\nsteps = 20\neffective_share = 0.5\ncorrelation = 0.5\n'
METHODS = ('methods = ["pattern_search", "interior_point"]\nstarts = 4', "methods = []")
DEGRADING = """[parameters.delta_eta]
distribution = "uniform"
low = 0
high = 20

[observation]"""


def plain(name, degrading=False, **changes):
    text = shortened(PLAIN, "6 s").replace(*METHODS).replace('name = "bouc_wen"', f'name = "{name}"')
    begin, end = text.index("\n[sampler]") + 1, text.index("\n[deterministic]") + 1
    text = text[:begin] + QUICK + "\n" + text[end:]
    return text.replace("[observation]", DEGRADING, 1) if degrading else text


@pytest.fixture(scope="module")
def studies(tmp_path_factory):
    folder = tmp_path_factory.mktemp("studies")
    for name, degrading in (("simple", False), ("degrading", True)):
        (folder / f"{name}.toml").write_text(plain(name, degrading))
        run_study(folder / f"{name}.toml", folder / name)
    return folder


def test_the_study_that_degrades_wins_where_the_structure_does(studies):
    comparison, page = compare_studies([studies / "simple", studies / "degrading"], studies / "page")
    assert comparison.best.name == "degrading" and comparison.bayes_factor(comparison.classes[0])[0] < -100.0
    assert comparison.classes[0].left_out.less(comparison.classes[1].left_out)[0] < -100.0
    text = page.read_text()
    assert comparison.verdict in text.replace("&#39;", "'") and text.count("<figure>") == 1
    assert (studies / "page" / "figures" / "predictions_velocity.pdf").is_file()


def test_on_the_command_line(studies, monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["structid", "compare", str(studies / "simple"), str(studies / "degrading")])
    with pytest.raises(SystemExit):
        cli.main()
    said = capsys.readouterr().out
    assert "log Bayes factor" in said and "degrading" in said and "unexplained" in said


def test_what_cannot_be_compared(studies, tmp_path):
    with pytest.raises(InputError, match="two or more"):
        compare_studies([studies / "simple"])
    with pytest.raises(InputError, match="holds no study"):
        compare_studies([studies / "simple", tmp_path])
    shutil.copytree(studies / "simple", tmp_path / "other")
    told = json.loads((tmp_path / "other" / "identity.json").read_text())
    told["study"]["observation"] = "another"
    (tmp_path / "other" / "identity.json").write_text(json.dumps(told))
    with pytest.raises(InputError, match="different measurements"):
        compare_studies([studies / "simple", tmp_path / "other"])


def test_a_study_is_checked_by_simulation(tmp_path, monkeypatch, capsys):
    (tmp_path / "study.toml").write_text(plain("study"))
    arguments = ["structid", "sbc", str(tmp_path / "study.toml"), "--replicas", "20", "--out", str(tmp_path / "sbc")]
    monkeypatch.setattr("sys.argv", arguments)
    with pytest.raises(SystemExit) as ended:
        cli.main()
    said = capsys.readouterr().out
    assert ended.value.code in (0, 3) and "90 % holds" in said and (tmp_path / "sbc" / "sbc.png").is_file()


def test_a_study_with_a_surrogate_is_checked_with_it_if_it_may_stand_in(tmp_path):
    """Twenty runs are too few for the gate; who trusts the surrogate all the same is heard, as in a run."""
    study = tmp_path / "study.toml"
    text = plain("study").replace('kind = "none"', 'kind = "pod_kriging"\nlimit = 1e-9') + "\n[campaign]\nruns = 20\n"
    study.write_text(text)
    with pytest.raises(InputError, match=r"1e-09 or less.*trust\(\)"):
        check_by_simulation(study, 20)
    study.write_text(text.replace("limit = 1e-9", "limit = 1e-9\ntrust = true"))
    found, figure = check_by_simulation(study, 20)
    assert figure is None and "stiffness" in str(found)


def test_the_packaged_study_is_certified_and_offers_every_sampler():
    assert "[calibration]" in PACKAGED and all(k in PACKAGED for k in ("aies", "nuts", "delayed_acceptance"))
