"""The report of a calibration that was made in Python: the same page that a study writes."""

import numpy as np
import pytest

import structid as si
from structid.figures import response as figures

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
        result,
        tmp_path / "new" / "out",
        title="Mine",
        other_records=[RECORD.scale(1.5)],
        true_values=TRUTH,
        channels=("displacement", "velocity"),
        progress=lambda done, total: drawn.append(done / total),
    )
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


FLOORS = si.ShearFrame(
    storeys=2,
    mass=1000.0,
    alpha=0.1,
    beta=200.0,
    gamma_ratio=0.5,
    damping_ratio=0.03,
    channels=("absolute_acceleration_1", "absolute_acceleration_2", "drift_1"),
    free=("stiffness_1", "stiffness_2"),
)


def test_several_observations_of_one_record_each_have_their_own_figures(tmp_path, monkeypatch):
    """Each figure has its observation's channel, unit and band; loops and energies are there once a storey."""
    space = si.ParameterSpace(
        stiffness_1=si.Normal(2.0, 0.1, unit="kN/mm"), stiffness_2=si.Normal(1.5, 0.1, unit="kN/mm")
    )
    run = FLOORS.simulate([[2.0e6, 1.5e6]], RECORD)
    noise = np.random.default_rng(3).standard_normal(run.values[0].shape) * 0.03 * run.values[0].std(axis=0)
    columns = dict(zip(run.channels, (run.values[0] + noise).T, strict=True))
    observations = [
        si.Observation(RECORD, columns[c], (c,))
        for c in ("drift_1", "absolute_acceleration_2", "absolute_acceleration_1")
    ]
    posterior = si.Posterior(space, FLOORS, observations, si.IID())
    result = si.sample(posterior, si.SMC(particles=60, ensembles=2, steps=5, effective_share=0.5), seed=1)
    drawn = {}
    inner = figures.bands

    def bands(time, measured, best, inner_band, outer, name, unit, **more):
        drawn[name] = (unit, measured, best, inner_band, outer)
        return inner(time, measured, best, inner_band, outer, name, unit, **more)

    monkeypatch.setattr(figures, "bands", bands)
    page = si.write_report(result, tmp_path)
    for channel, unit, by in (("drift_1", "mm", 1e-3), ("absolute_acceleration_2", "m/s^2", 1.0)):
        shown, measured, best, inside, outside = drawn[channel]
        assert shown == unit
        np.testing.assert_allclose(measured, columns[channel] / by)
        assert np.std(measured - best) < 0.1 * np.std(measured)
        assert np.mean((measured > outside[0]) & (measured < outside[1])) > 0.8
        assert (inside[1] - inside[0]).max() < np.ptp(measured)
    names = sorted(p.stem for p in (tmp_path / "figures").glob("*.svg"))
    assert [n for n in names if n.startswith("loops")] == ["loops_storey_1_1", "loops_storey_2_1"]
    assert [n for n in names if n.startswith("energy")] == ["energy_storey_1_1", "energy_storey_2_1"]
    assert [n for n in names if n.startswith("residuals")] == [
        "residuals_absolute_acceleration_1_3",
        "residuals_absolute_acceleration_2_2",
        "residuals_drift_1_1",
    ]
    assert [n for n in names if n.startswith("record")] == ["record_1"]
    assert "Hysteresis loops of storey 2 for" in page.read_text()


@pytest.mark.parametrize("kind", [si.DisplacementHistory, si.ForceHistory])
def test_a_test_that_is_driven_in_another_way_has_a_page(tmp_path, kind):
    time = np.arange(400) * 0.01
    size = {si.DisplacementHistory: 0.02, si.ForceHistory: 3e4}[kind]
    driven = kind(size * np.linspace(0.0, 1.0, 400) * np.sin(2 * np.pi * time), 0.01, "cycles")
    channel = "restoring_force" if kind is si.DisplacementHistory else "displacement"
    model = si.BoucWen(**KNOWN, free=SPACE.names, channels=(channel,))
    values = model.simulate([[7.6e6, 63.0]], driven).values[0]
    noise = 0.02 * values.std() * np.random.default_rng(1).standard_normal(values.shape)
    posterior = si.Posterior(SPACE, model, si.Observation(driven, values + noise, (channel,)), si.IID())
    result = si.sample(posterior, si.SMC(particles=60, ensembles=2, steps=5, effective_share=0.5), seed=1)
    text = si.write_report(result, tmp_path).read_text()
    assert "Excitation of the structure: cycles" in text and (tmp_path / "figures" / "loops.svg").is_file()
