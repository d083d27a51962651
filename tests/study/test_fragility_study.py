"""The table [fragility] of a study: posterior draws on records of rising strength, the page again, mistakes in a paragraph."""

import numpy as np
import pytest

import structid as si
from structid.reliability.fragility import Fragility
from structid.study.run import load, report_again, run_study
from studies import SMALL

FRAGILITY = """
[fragility]
channel = "displacement"
limit = "25 mm"
pga = ["0.5 m/s^2", "4 m/s^2", "9 m/s^2"]
draws = 20

[[fragility.records]]
name = "one"
synthetic = { seed = 11 }
trim = ["3 s", "9 s"]

[[fragility.records]]
name = "another"
synthetic = { seed = 12 }
trim = ["3 s", "9 s"]
"""
STUDY = SMALL + FRAGILITY


@pytest.fixture
def study(tmp_path):
    (tmp_path / "study.toml").write_text(STUDY)
    return tmp_path / "study.toml"


@pytest.mark.slow
def test_records_of_rising_strength_and_the_page_again(study):
    folder = study.parent / "out"
    outcome = run_study(study, folder)
    found = outcome.results[Fragility]
    assert found.records == ("one", "another") and found.passed.shape == (20, 2, 3) and found.limit == 0.025
    np.testing.assert_allclose(found.levels, [0.5, 4.0, 9.0])
    assert found.true_runs == found.passed.size and np.isin(found.passed, (0.0, 1.0)).all()
    assert found.probability[0] == 0.0 and found.probability[-1] > 0.9
    # The same draws on the same record, by hand.
    model = load(study).model.recording("displacement")
    record = si.GroundMotion.synthetic(seed=11).trim(3.0, 9.0).scale_to_pga(4.0)
    draws = outcome.result.thinned(20)
    theta = draws[:, [outcome.result.names.index(name) for name in model.free]]
    largest = np.abs(model.simulate(theta, record).values[:, :, 0]).max(axis=1)
    assert found.of_each[0, 1] == pytest.approx((largest > 0.025).mean())
    page = outcome.report.read_text()
    assert "Probability of failure" in page
    again = report_again(folder)
    np.testing.assert_array_equal(again.results[Fragility].passed, found.passed)
    assert again.report.read_text().count("<figure>") == page.count("<figure>")


@pytest.mark.parametrize(
    ("said", "instead", "told"),
    [
        ('limit = "25 mm"', 'limit = "25 kN"', "fragility.limit"),
        ('channel = "displacement"\nlimit', 'channel = "displacment"\nlimit', "displacement"),
        ('"9 m/s^2"]', '"9 m/s"]', "fragility.pga"),
        ("draws = 20\n", "draws = 202499170860\n", "fragility.draws.*at most 1000000"),
        ("draws = 20\n", "draws = 20\nsurrogate = true\n", "fragility.draws.*91 or more"),
        ("[[fragility.records]]", "[[fragility.record]]", "records"),
    ],
)
def test_a_mistake_is_one_paragraph(study, said, instead, told):
    assert said in STUDY
    study.write_text(STUDY.replace(said, instead))
    with pytest.raises(si.InputError, match=told):
        load(study)


def test_without_a_measurement_it_is_given_nothing(study):
    study.write_text(SMALL[: SMALL.index("[observation]")] + FRAGILITY)
    with pytest.raises(si.InputError, match=r"\[observation\]"):
        load(study)
