"""The report of a calibration that was made in Python: the same page that a study writes."""

import numpy as np
import pytest

import structid as si

RECORD = si.GroundMotion.synthetic(seed=8, duration=4.0).scale_to_pga(1.8)
KNOWN = dict(mass=12_000.0, damping_ratio=0.03, alpha=0.05, gamma_ratio=0.5)
SPACE = si.ParameterSpace(
    stiffness=si.Normal(7.42, 0.742, low=4.0, unit="kN/mm"), beta=si.Uniform(50.0, 70.0, unit="1/m")
)
TRUTH = {"stiffness": 7.6e6, "beta": 63.0}


def measured():
    velocity = si.BoucWen(**KNOWN, **TRUTH).simulate(np.zeros((1, 0)), RECORD).channel("velocity")[0]
    noise = 0.02 * velocity.std() * np.random.default_rng(1).standard_normal(velocity.shape)
    return si.Observation(RECORD, velocity + noise)


def test_draws_of_the_model_have_a_page(tmp_path):
    posterior = si.Posterior(SPACE, si.BoucWen(**KNOWN, free=SPACE.names), measured(), si.IID())
    result = si.sample(posterior, si.SMC(particles=100, steps=10), seed=1)
    drawn = []
    page = si.write_report(
        result, tmp_path / "new" / "out", title="Mine", other_records=[RECORD.scale(1.5)], true_values=TRUTH,
        channels=("displacement", "velocity"), progress=lambda done, total: drawn.append(done / total),
    )  # fmt: skip
    text = page.read_text()
    assert page == tmp_path / "new" / "out" / "report.html" and drawn[-1] == 1.0
    for said in (
        "<h1>Mine</h1>",
        "yield displacement [mm]",
        "stiffness [kN/mm]",
        "Other records",
        "BoucWen",
        "truth",
    ):
        assert said in text, said
    assert {p.stem for p in (page.parent / "figures").glob("other_1_*.svg")} == {
        "other_1_displacement",
        "other_1_velocity",
    }
    assert "Surrogate" not in text and len(list((page.parent / "figures").glob("*.svg"))) > 5


@pytest.mark.slow
def test_a_certified_calibration_has_a_page(tmp_path):
    result = si.calibrate(
        si.BoucWen(**KNOWN, free=SPACE.names), SPACE, measured(), discrepancy="auto", true_runs=150, seed=1
    )
    text = si.write_report(result, tmp_path).read_text()
    assert result.certified and "Certified: surrogate and model agree" in text and "The data choose" in text


def test_draws_of_something_else_are_refused(tmp_path):
    space = si.ParameterSpace(x=si.Uniform(-5.0, 5.0))
    target = si.LogDensity(lambda x: -0.5 * (x**2).sum(axis=1), ("x",), space, {"x": (-5.0, 5.0)})
    result = si.sample(target, si.SMC(particles=100, steps=5), seed=1)
    with pytest.raises(si.InputError, match="draws of a LogDensity"):
        si.write_report(result, tmp_path / "out")
    assert not (tmp_path / "out").exists()
