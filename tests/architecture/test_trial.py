"""A trial: a model, a surrogate, a discrepancy, a section and a command are each one new file and one line of registration.

The files are beside this one, in `trial/`. A line of registration is `register(list, name, what)` here, which stands for a line in
the list.
"""

import pytest
from trial import new_command, new_discrepancy, new_model, new_section, new_surrogate

import structid as si
from commands import structid
from structid.cli.commands import command_list
from structid.inference.diagnostics.robust_spread import robust_spread
from structid.inference.error_models import error_model_list
from structid.models import model_list
from structid.report import section_list
from structid.study.run import run_study
from structid.surrogates import surrogate_list as registry

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
kind = "smc"
particles = 100
steps = 20
ensembles = 2

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
    register(section_list, "OF_A_CALIBRATION", new_section.SECTION)
    register(command_list, "COMMANDS", new_command.parameters)


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
    assert type(outcome.surrogate) is new_surrogate.FittedQuadratic
    assert outcome.result.target.names == ("frequency", "b_displacement")
    page = outcome.report.read_text()
    for words in ("A section of my own", "Words of my own.", "How many draws there are", "QuadraticResponse"):
        assert words in page
    again = si.load_surrogate(tmp_path / "out" / "surrogate.h5")
    assert type(again) is new_surrogate.FittedQuadratic


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


def test_without_the_lines_nothing_of_it_is_known(tmp_path):
    (tmp_path / "study.toml").write_text(STUDY)
    said = structid("check", tmp_path / "study.toml", cwd=tmp_path)
    assert said.returncode == 2 and "linear_oscillator" in said.stderr and "quadratic_response" in said.stderr
