"""Values that would fill the memory, run for minutes or fail deep inside are refused at the door, by one sentence."""

import numpy as np
import pytest
import scipy.stats

import structid as si
from structid.core.errors import InputError

pytestmark = pytest.mark.quick
RECORD = si.GroundMotion.synthetic(seed=3).trim(3.0, 5.0)
SPACE = si.ParameterSpace(x=si.Uniform(-5.0, 5.0))
BOX = {"x": (-5.0, 5.0)}


def density(function=lambda x: -(x[:, 0] ** 2), bounds=BOX):
    return si.LogDensity(function, ("x",), SPACE, bounds)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: RECORD.pad(1e9), "pad: a signal of 1e.11 samples"),
        (lambda: RECORD.pad(after=np.inf), "pad: a signal of inf samples"),
        (lambda: RECORD.resample(1e-9), "a signal of .* samples"),
        (lambda: si.GroundMotion.synthetic(seed=1, duration=1e9), "a signal of 1e.11 samples"),
        (lambda: si.GroundMotion.synthetic(seed=1, dt=1e-9), "a signal of 4e.10 samples"),
        (lambda: RECORD.lowpass(1e9), "between 0 and the Nyquist frequency, 50 Hz"),
        (lambda: RECORD.response_spectrum(np.array([0.1, np.nan])), "periods: nan s"),
        (lambda: RECORD.response_spectrum(np.array([1e-9])), "periods: 1e-09 s.*at least 0.0001 s"),
        (lambda: RECORD.response_spectrum(np.array([])), "one or more periods"),
        (lambda: RECORD.response_spectrum(damping_ratio=5.0), "damping_ratio: 5.*0.05 for 5 %"),
        (lambda: density(bounds={"x": (5.0, -5.0)}), r"LogDensity.bounds\['x'\]: \(5.0, -5.0\)"),
        (lambda: density(bounds={"x": (np.nan, 1.0)}), r"LogDensity.bounds\['x'\]"),
        (lambda: density(bounds={"x": 1.0}), r"LogDensity.bounds\['x'\]"),
        (lambda: density().log_density([1.0, 2.0]), r"an array of shape \(2,\).*\(run, 1\)"),
        (lambda: density(lambda x: np.full(len(x), np.inf)).log_density([[0.5]]), r"\+inf at the point \(0.5\)"),
        (
            lambda: si.sample(
                density(lambda x: np.where(x[:, 0] > 1.0, np.inf, 0.0)), si.SMC(particles=50, steps=5), seed=1
            ),
            r"\+inf at the point",
        ),
        (lambda: si.certify(density(), np.ones((500, 1)), limits=0.02), r"certify\(limits\): a float.*structid.Limits"),
        (lambda: si.Plan(limits=0.02), r"Plan\(limits\): a float"),
        (
            lambda: si.Frozen(scipy.stats.Normal(mu=1.0, sigma=2.0)),
            "one of SciPy's new distributions.*scipy.stats.norm",
        ),
    ],
)
def test_it_is_refused(call, words):
    with pytest.raises(InputError, match=words):
        call()


@pytest.mark.parametrize(
    "name", ["k/m", "", " k", "k ", "<b>", "a&b", "$k$", "k\n", "2k", "k,m", 'k"', "chain", "draw", "ensemble"]
)
def test_names_that_an_output_cannot_carry(name):
    with pytest.raises(InputError, match=r"ParameterSpace: (the name|an empty name)"):
        si.ParameterSpace(**{name: si.Normal(1.0, 0.1)})
    with pytest.raises(InputError, match=r"ParameterSpace: (the name|an empty name)"):
        si.ParameterSpace(derived={name: "2 * x"}, x=si.Normal(1.0, 0.1))
    if name not in ("chain", "draw", "ensemble"):
        with pytest.raises(InputError, match=r"CallableModel\.channels"):
            si.CallableModel(print, ("k",), (name,))
        with pytest.raises(InputError, match="observation: channels"):
            si.Observation(RECORD, RECORD.values, (name,))


@pytest.mark.parametrize("name", ["k", "stiffness_1", "β", "E.mod", "k-1", "b[0]", "b[0, 1]", "_k", "yield force"])
def test_names_that_every_output_carries(name, tmp_path):
    """Through a table, netCDF, a page's table and back."""
    space = si.ParameterSpace(**{name: si.Normal(1.0, 0.1)})
    target = si.LogDensity(space.log_density, (name,), space)
    result = si.sample(target, si.SMC(particles=60, ensembles=2, steps=5, effective_share=0.5), seed=1)
    path = result.to_netcdf(tmp_path / "draws.nc", predictions=False)
    assert si.certify(target, path, space.log_density).names == (name,)
    space.sample(5, seed=1).to_csv(tmp_path / "design.csv")
    assert name in (tmp_path / "design.csv").read_text(encoding="utf-8") and name in str(result.summary())


def test_a_channel_twice_is_refused():
    with pytest.raises(InputError, match=r"velocity, velocity\. Expected: each channel once"):
        si.Observation(RECORD, np.ones((len(RECORD), 2)), ("velocity", "velocity"))


def test_one_point_of_a_density_comes_without_the_axis_of_runs():
    assert density().log_density([1.5]).tolist() == [-2.25]
    assert density(lambda x: -(x**2)).log_density([[1.0], [2.0]]).tolist() == [-1.0, -4.0]


def test_a_posterior_of_the_errors_alone():
    """A model without free parameters and an unknown variance: its posterior is the inverse gamma's, to the prior's bounds."""
    model = si.BoucWen(mass=12e3, stiffness=7.6e6, alpha=0.05, beta=60.0, gamma=30.0, damping_ratio=0.03)
    noise = 0.01 * np.random.default_rng(0).standard_normal(len(RECORD))
    values = model.simulate(np.zeros((1, 0)), RECORD).values[0, :, 0] + noise
    posterior = si.Posterior(si.ParameterSpace(), model, si.Observation(RECORD, values), si.IID())
    result = si.sample(posterior, si.SMC(particles=200, steps=20), seed=1)
    shape, scale = 0.5 * len(RECORD) - 1.0, 0.5 * float(noise @ noise)
    exact = scipy.stats.invgamma(shape, scale=scale)
    assert abs(result.mean[0] - exact.mean()) < 0.1 * exact.std()
    assert abs(result.sd[0] / exact.std() - 1.0) < 0.1
    assert "sigma2" in str(result.summary()) and result.predict().response.shape[1] == len(RECORD)


def test_a_single_limit_needs_no_list():
    space = si.ParameterSpace(stiffness=si.Uniform(6.0, 9.0, unit="kN/mm"), alpha=si.Uniform(0.05, 0.1))
    model = si.BoucWen(
        mass=12e3, beta=60.0, gamma=30.0, damping_ratio=0.03, free=space.names, channels=("displacement",)
    )
    design = space.sample(50, seed=1)
    runs = si.Runs.from_histories(design, model.simulate(design, RECORD), RECORD)
    assert [p.limit for p in si.parameter_study(runs, "displacement", 0.02).passages] == [0.02]
