"""A structure that failed is data: not tried again, impossible in a likelihood, and no failed simulation."""

import numpy as np
import pytest

import structid as si

RECORD = si.GroundMotion.synthetic(seed=2).trim(0.0, 4.0)


def shaken(parameters, record):
    """Collapses where it is weak, dies of its solver where it is stiff."""
    motion = np.cumsum(record.values) * record.dt / parameters["strength"]
    if parameters["strength"] < 0.4:
        raise si.StructureFailedError("drift beyond 5 %", motion[:100])
    if parameters["strength"] > 0.9:
        raise si.SolverError("no convergence", motion[:50])
    return motion


def model(isolated=False):
    return si.CallableModel(shaken, ("strength",), ("velocity",), isolated=isolated)


@pytest.mark.parametrize("isolated", [False, True])
def test_it_is_a_row_with_a_status_of_its_own_and_its_response_until_then(isolated):
    found = model(isolated).simulate(np.array([[0.3], [0.5], [0.95]]), RECORD)
    assert list(found.status) == [si.Status.STRUCTURE_FAILED, si.Status.DONE, si.Status.FAILED]
    assert list(found.done) == [False, True, False]
    assert found.reasons[0] == "drift beyond 5 %" and found.failure_time[0] == pytest.approx(100 * RECORD.dt)
    assert np.isfinite(found.values[0, :100]).all() and np.isnan(found.values[0, 100:]).all()
    assert si.Status.STRUCTURE_FAILED.words == "structure failed" and not si.Status.STRUCTURE_FAILED.run_failed
    assert si.Status.FAILED.run_failed and si.Status.DIVERGED.run_failed and not si.Status.DONE.run_failed


def test_a_campaign_counts_it_by_itself_and_never_tries_it_again(tmp_path):
    space = si.ParameterSpace(strength=si.Uniform(0.1, 1.0))
    design = space.sample(20, seed=1)
    strength = design.values[:, 0]
    told = []
    campaign = si.Campaign(model(), RECORD, design, store=tmp_path / "runs.h5")
    runs = campaign.run(attempts=3, progress=lambda done, total, failed: told.append(failed))
    assert runs.counts[si.Status.STRUCTURE_FAILED] == (strength < 0.4).sum() > 0
    assert runs.counts[si.Status.FAILED] == (strength > 0.9).sum() == told[-1] > 0
    assert (runs.attempts[strength < 0.4] == 1).all() and (runs.attempts[strength > 0.9] == 3).all()
    again = si.Campaign(model(), RECORD, design, store=tmp_path / "runs.h5").run(retry=True)
    assert (again.attempts[strength < 0.4] == 1).all() and (again.attempts[strength > 0.9] == 4).all()


def test_a_sampler_finds_it_impossible_and_does_not_count_it_as_failed():
    space = si.ParameterSpace(strength=si.Uniform(0.1, 0.9))
    truth = shaken({"strength": 0.5}, RECORD)
    posterior = si.Posterior(space, model(), si.Observation(RECORD, truth), si.IID(variance=1e-4))
    phi = posterior.bijection.inverse(np.array([[0.3], [0.5]]))
    density, failed = posterior.evaluate(phi)
    assert density[0] == -np.inf and np.isfinite(density[1]) and not failed.any()
    wider = si.Posterior(si.ParameterSpace(strength=si.Uniform(0.1, 1.0)), model(), si.Observation(RECORD, truth))
    assert wider.evaluate(wider.bijection.inverse(np.array([[0.95, 0.01]])))[1].all()


def test_a_channel_of_ones_own_has_the_unit_that_the_model_declares(tmp_path):
    def crack(parameters, record):
        return 1e-3 * parameters["strength"] * np.abs(np.sin(record.time))

    own = si.CallableModel(crack, ("strength",), ("crack_width",), isolated=False, units={"crack_width": "mm"})
    assert own.channel_units["crack_width"] == ("m", "mm")
    found = own.simulate([[0.5]], RECORD)
    header = found.to_csv(tmp_path / "crack.csv", display=True).read_text().splitlines()[0]
    assert header == "time [s],crack_width [mm]"
    observation = si.Observation(RECORD, found.values[0], ("crack_width",), units={"crack_width": "mm"})
    space = si.ParameterSpace(strength=si.Uniform(0.1, 0.9))
    posterior = si.Posterior(space, own, observation)
    assert posterior.units["sigma2"] == "(m)^2"
    assert si.sample(posterior, si.SMC(particles=20, steps=2, ensembles=1), seed=1).predict(draws=5).units == {
        "crack_width": ("m", "mm")
    }
    with pytest.raises(si.InputError, match="a unit of the same dimension"):
        si.CallableModel(crack, ("strength",), ("velocity",), units={"velocity": "mm"})
    with pytest.raises(si.InputError, match="crack_width"):
        si.CallableModel(crack, ("strength",), ("crack_width",), units={"crack": "mm"})


def test_runs_with_collapses_are_drawn_and_calibrated_with(tmp_path):
    space = si.ParameterSpace(strength=si.Uniform(0.1, 0.89))
    runs = si.Campaign(model(), RECORD, space.sample(20, seed=1)).run()
    runs.plot(tmp_path / "runs")
    assert "structure failed" in str(runs)


def test_a_program_says_it_by_its_exit_code(tmp_path):
    (tmp_path / "solver.py").write_text(
        "import sys\nstrength = float(sys.argv[1])\n"
        "open('out.csv', 'w').write('velocity\\n' + '1.0\\n' * 30)\nprint('drift beyond 5 %')\nsys.exit(int(sys.argv[2]))\n"
    )
    for code, status in ((7, si.Status.STRUCTURE_FAILED), (3, si.Status.FAILED)):
        program = si.ProgramModel(
            ["python3", str(tmp_path / "solver.py"), "{{ strength }}", str(code)],
            ("strength",),
            si.OutputFile("out.csv", {"velocity": "velocity"}),
            scratch=tmp_path / "scratch",
            structure_failed_exit_code=7,
        )
        found = program.simulate([[0.5]], RECORD)
        assert found.status[0] == status and "drift beyond 5 %" in found.reasons[0]
        assert np.isfinite(found.values[0, :30]).all() and np.isnan(found.values[0, 30:]).all()
