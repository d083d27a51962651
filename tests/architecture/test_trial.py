"""A trial: everything that can be added is one new file and one line in a list.

It adds one of each kind in the table of the architecture page: a model, a surrogate, an error model, a sampler, a section, a stage
with a table and a result of its own, a command, a file format and a purpose of random numbers. The files are in `trial/` beside
this one. A call of `register(module, name, what)` here stands for a line in the list.
"""

from enum import IntEnum

import numpy as np
import pytest
from trial import (
    new_command,
    new_discrepancy,
    new_format,
    new_law,
    new_model,
    new_sampler,
    new_section,
    new_stage,
    new_surrogate,
)

import structid as si
from commands import structid
from structid.cli.commands import command_list
from structid.core import streams
from structid.data_files import format_list
from structid.inference.diagnostics.robust_spread import robust_spread
from structid.inference.error_models import error_model_list
from structid.inference.sampling import sampler_list
from structid.mechanics.hysteretic_laws import law_list
from structid.models import model_list
from structid.report import section_list
from structid.study.run import report_again, run_study
from structid.study.stages import stage_list
from structid.surrogates import surrogate_list as registry
from structid.surrogates.base import Surrogate

STUDY = """
name = "trial"
seed = 3

[record.synthetic]
seed = 5
duration = "6 s"
dt = "0.02 s"
middle = "2 s"
significant_duration = "3 s"

[model]
type = "linear_oscillator"
damping_ratio = 0.05

[parameters.frequency]
distribution = "uniform"
low = 1.9
high = 2.1
unit = "Hz"

[observation]
channels = ["displacement"]

[observation.virtual]
noise = 0.2

[observation.virtual.model]
type = "linear_oscillator"
frequency = "2.02 Hz"
damping_ratio = 0.05

[discrepancy]
kind = "laplace"
floor = 0.0

[campaign]
runs = 20

[surrogate]
kind = "quadratic_response"
degree = 3
validation = 10

[sampler]
kind = "random_walk"
scale = 0.08

[largest_response]
channel = "displacement"

[prediction]
draws = 20
"""


@pytest.fixture
def registered(monkeypatch):
    def register(where, name, what):
        monkeypatch.setattr(where, name, (*getattr(where, name), what))

    register(model_list, "MODELS", new_model.KIND)
    register(registry, "KINDS", new_surrogate.KIND)
    register(error_model_list, "ERROR_MODELS", new_discrepancy.KIND)
    register(sampler_list, "SAMPLERS", new_sampler.KIND)
    register(section_list, "OF_A_CALIBRATION", new_section.SECTION)
    register(stage_list, "STAGES", new_stage.STAGE)
    register(command_list, "COMMANDS", new_command.parameters)
    register(format_list, "TEXT_FORMATS", new_format.FORMAT)
    monkeypatch.setitem(law_list.LAWS, "cubic", new_law.Cubic)
    purposes = {purpose.name: purpose.value for purpose in streams.Purpose}
    monkeypatch.setattr(streams, "Purpose", IntEnum("Purpose", purposes | {"RANDOM_WALK": 7_001}))


@pytest.fixture
def study(registered, tmp_path):
    path = tmp_path / "study.toml"
    path.write_text(STUDY)
    return path


def test_a_study_of_new_things_runs_from_its_file_to_its_page(study, tmp_path):
    outcome = run_study(study, tmp_path / "out")
    frequency = outcome.result.summary().row("frequency")
    # The prior's sd is 0.06; the surrogate is worth a tenth of that.
    assert abs(frequency["mean"] - 2.02) < 0.006 and frequency["sd"] < 0.006
    assert type(outcome.results[Surrogate]) is new_surrogate.FittedQuadratic
    assert outcome.result.target.names == ("frequency", "b_displacement")
    page = outcome.report.read_text()
    largest = outcome.results[new_stage.LargestResponse]
    shown = (
        "A section of my own",
        "Words of my own.",
        f"{largest.peaks.mean():.5f}",
        "QuadraticResponse",
        "random walk",
    )
    for words in shown:
        assert words in page
    again = si.load_surrogate(tmp_path / "out" / "surrogate.h5")
    assert type(again) is new_surrogate.FittedQuadratic


def test_the_study_is_read_back_without_sampling_again(study, tmp_path):
    first = run_study(study, tmp_path / "out")
    (tmp_path / "out" / "report.html").unlink()
    again = report_again(tmp_path / "out")
    np.testing.assert_array_equal(again.result.history, first.result.history)
    kind = new_stage.LargestResponse
    np.testing.assert_array_equal(again.results[kind].peaks, first.results[kind].peaks)
    assert "A section of my own" in again.report.read_text()


def test_a_new_hysteretic_law_is_simulated(registered):
    law = si.Hysteretic("cubic", {"stiffness": 10.0}, free=("stiffening",))
    forces = law.simulate([[0.5]], si.DisplacementHistory([0.0, 0.2, -0.4], dt=1.0)).channel("restoring_force")[0]
    np.testing.assert_allclose(forces, [0.0, 2.0 * 1.02, -4.0 * 1.08])


def test_a_new_sampler_draws_from_a_known_density(registered):
    """A normal: mean and sd within four of their Monte Carlo errors; with half the scale in the density, it fails."""
    space = si.ParameterSpace(x=si.Normal(0.0, 10.0))
    sampler = new_sampler.RandomWalk(walkers=50, steps=1500, scale=2.4)
    result = si.sample(si.LogDensity(lambda x: -0.5 * (x[..., 0] - 3.0) ** 2, ("x",), space), sampler, seed=1)
    draws = result.kept.reshape(len(result.kept), -1)
    chains = draws.mean(axis=0)
    error = chains.std(ddof=1) / np.sqrt(chains.size)
    assert abs(draws.mean() - 3.0) < 4.0 * error < 0.1
    assert abs(draws.std() - 1.0) < 0.05


def test_a_new_table_is_checked_and_counted(study):
    said = structid("check", study, cwd=study.parent)
    assert said.returncode == 0 and "Largest response: 50 model runs" in said.stdout
    study.write_text(STUDY.replace('channel = "displacement"', 'chanel = "displacement"'))
    said = structid("check", study, cwd=study.parent)
    assert said.returncode == 2 and "key 'largest_response.chanel'" in said.stderr
    study.write_text(STUDY.replace('channel = "displacement"', 'channel = "velocity"'))
    said = structid("check", study, cwd=study.parent)
    assert said.returncode == 2 and "velocity" in said.stderr


def test_a_stage_that_needs_draws_needs_a_measurement(study):
    text = STUDY[: STUDY.index("[observation]")] + STUDY[STUDY.index("[campaign]") :]
    study.write_text(text)
    said = structid("check", study, cwd=study.parent)
    assert said.returncode == 2 and "table 'largest_response': no [observation]" in said.stderr


def test_a_model_in_one_call_needs_no_workers_and_has_no_derivatives(registered):
    model = new_model.LinearOscillator(free=("frequency",))
    assert model.batched and not model.traceable and not model.guarded
    record = si.GroundMotion.synthetic(seed=5).trim(0.0, 6.0)
    space = si.ParameterSpace(frequency=si.Uniform(1.5, 2.5, unit="Hz"))
    truth = model.simulate([[2.0]], record).values[0]
    posterior = si.Posterior(space, model, si.Observation(record, truth, ("displacement",)), si.IID(variance=1e-6))
    assert not posterior.costs_runs and not posterior.misfit.differentiable
    with pytest.raises(si.InputError, match="no derivatives"):
        posterior.misfit.linearised([[2.0]])
    found = si.sample(posterior, si.SMC(particles=60, steps=10, ensembles=2), seed=1)
    assert abs(found.mean[0] - 2.0) < 0.01
    assert (robust_spread(posterior, found.thinned()).sd > 0.0).all()


def test_a_mistake_in_a_new_table_is_told_as_in_any_other(study):
    study.write_text(STUDY.replace("degree = 3", "degre = 3"))
    said = structid("check", study, cwd=study.parent)
    assert said.returncode == 2 and "Did you mean 'degree'?" in said.stderr
    study.write_text(STUDY.replace('frequency = "2.02 Hz"', 'frequency = "2.02 m"'))
    assert "frequency" in structid("check", study, cwd=study.parent).stderr


def test_a_new_command_is_called_by_its_name(study):
    said = structid("parameters", study, cwd=study.parent)
    assert said.returncode == 0 and said.stdout.strip() == "frequency"
    assert "parameters" in structid("--help", cwd=study.parent).stdout


def test_a_new_format_is_read_as_a_record_and_looked_at(registered, tmp_path):
    (tmp_path / "r.dat").write_text("TABLETOP SHAKER\n0.02\n1.0\n-3.0\n2.0\n")
    record = si.GroundMotion.read(tmp_path / "r.dat")
    assert record.dt == 0.02 and record.pga == pytest.approx(0.03)
    assert si.look(tmp_path / "r.dat").format == "tabletop shaker"


def test_without_the_lines_nothing_of_it_is_known(tmp_path):
    (tmp_path / "study.toml").write_text(STUDY)
    said = structid("check", tmp_path / "study.toml", cwd=tmp_path)
    assert said.returncode == 2 and "linear_oscillator" in said.stderr and "quadratic_response" in said.stderr
