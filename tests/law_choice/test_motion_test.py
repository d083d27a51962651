"""The choice of a hysteretic law from responses to motions."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.special

import structid as si
from structid.inference.error_models.independent import IID
from structid.law_choice.law_fit import refine_law, search_law
from structid.law_choice.motion_test import MotionTest
from structid.mechanics.hysteretic_laws.law_list import law_of
from structid.optimize.many_starts import refined

MASS, STIFFNESS, YIELD_FORCE = 12e3, 2.4e6, 15e3
CHANNELS = ("displacement", "absolute_acceleration")
DAMPING = {"damping_ratio": si.Uniform(0.0, 0.1)}


def record(duration: float = 12.0) -> si.GroundMotion:
    return si.GroundMotion.synthetic(seed=4, arias=3.0).trim(2.0, 2.0 + duration)


def responses(law: str = "bilinear", noise: float = 0.02, excitation=None, **values) -> list[si.Observation]:
    excitation = record() if excitation is None else excitation
    values = {"stiffness": STIFFNESS, "yield_force": YIELD_FORCE, "hardening": 0.05} | values
    values = {name: value for name, value in values.items() if name in law_of("test", law).parameters()}
    model = si.Hysteretic(law, values, mass=MASS, damping_ratio=0.03, channels=CHANNELS)
    y = model.simulate(np.zeros((1, 0)), excitation).values[0]
    y = y + noise * np.sqrt((y**2).mean(axis=0)) * np.random.default_rng(7).normal(size=y.shape)
    return [si.Observation(excitation, y[:, [i]], channels=(c,)) for i, c in enumerate(CHANNELS)]


@pytest.fixture(scope="module")
def shaken() -> MotionTest:
    return MotionTest(responses(), mass=MASS, own_priors=DAMPING)


def test_the_residuals_at_the_true_parameters_are_the_noise():
    without = MotionTest(responses(noise=0.0), mass=MASS, own_priors=DAMPING)
    law = law_of("test", "bilinear")
    space = without.unknowns(law)
    truth = {
        "stiffness": STIFFNESS,
        "yield_force": YIELD_FORCE,
        "hardening": 0.05,
        "asymmetry": 1.0,
        "damping_ratio": 0.03,
    }
    theta = np.array([[truth[name] for name in space.names]])
    residuals = without.residuals(law, space)(theta)[0]
    assert np.abs(residuals / without.scales).max() < 1e-12
    assert without.unexplained(residuals) < 1e-20
    stiffer = without.residuals(law, space)(theta * np.where(np.array(space.names) == "stiffness", 1.1, 1.0))[0]
    assert without.unexplained(stiffer) > 1e-4


def test_sensors_of_every_kind_give_the_likelihood_of_the_posterior():
    displacement, acceleration = responses()
    values = acceleration.values.copy()
    values[200:260] = np.nan
    late = displacement.values[30::2]
    sensors = [
        si.Observation(
            displacement.record,
            values,
            channels=acceleration.channels,
            offset=si.Normal(0.0, 0.1),
            gain=si.Normal(1.0, 0.1),
        ),
        si.Observation(
            displacement.record, -late, channels=displacement.channels, dt=0.02, start=0.3, polarity="reversed"
        ),
    ]
    test = MotionTest(sensors, mass=MASS, own_priors=DAMPING)
    law = law_of("test", "bilinear")
    posterior, space = test.posterior(law), test.unknowns(law)
    assert {"gain_1", "offset_1"} <= set(space.names)
    theta = space.sample(5, 0).values
    residuals = test.residuals(law, space)(theta)
    variances = np.array([0.03, 2e-6])
    whole = np.empty((5, posterior.dimension))
    for name, column in zip(space.names, theta.T, strict=True):
        whole[:, posterior.names.index(name)] = column
    for number, variance in enumerate(variances, start=1):
        whole[:, posterior.names.index(f"sigma2_{number}")] = variance
    expected = sum(
        -0.5 * (residuals[:, block] ** 2).sum(axis=1) / variance
        - 0.5 * len(sensor.values) * np.log(2.0 * np.pi * variance)
        for block, sensor, variance in zip(test.blocks, test.sensors, variances, strict=True)
    )
    assert len(test.sensors[0].values) == len(values) - 60
    assert test.sensors[0].gaps.max() == 61
    np.testing.assert_allclose(posterior.log_likelihood(whole), expected, rtol=1e-9)


def test_the_scales_are_those_of_the_specimen(shaken):
    elastic = MotionTest(responses("linear"), mass=MASS, damping_ratio=0.03)
    assert elastic.initial_stiffness / 1.5 == pytest.approx(STIFFNESS, rel=0.06)
    space = shaken.priors(law_of("test", "bilinear"))
    quantiles = dict(zip(space.names, space.cdf(np.array([[STIFFNESS, YIELD_FORCE, 0.05, 1.0, 0.03]]))[0], strict=True))
    assert all(0.02 < quantile < 0.98 for quantile in quantiles.values()), quantiles
    alone = MotionTest(responses()[1], mass=MASS, own_priors=DAMPING)
    assert alone.largest_displacement == pytest.approx(shaken.largest_displacement, rel=0.5)


def test_a_wrong_unit_is_questioned(shaken):
    assert shaken.questions == ()
    # A wrong mass goes unseen here: stiffness and force are wrong by the same factor.
    in_tons = MotionTest(responses(), mass=MASS / 1e3, own_priors=DAMPING)
    assert in_tons.questions == ()
    small = [si.Observation(o.record, 1e-3 * o.values, channels=o.channels) for o in responses()]
    assert "at the end of the range" in MotionTest(small, mass=MASS, own_priors=DAMPING).questions[0]


def test_the_first_part_has_most_of_the_response_and_the_same_priors(shaken):
    first, law = shaken.first, law_of("test", "bilinear")
    assert first is not None
    assert first.first is None
    assert first.priors(law).content_hash == shaken.priors(law).content_hash
    shares = [
        (part.values**2).sum() / (whole.values**2).sum()
        for part, whole in zip(first.sensors, shaken.sensors, strict=True)
    ]
    assert np.mean(shares) == pytest.approx(0.7, abs=0.02)
    for part, whole in zip(first.sensors, shaken.sensors, strict=True):
        np.testing.assert_array_equal(part.values, whole.values[: len(part.values)])
    multisine = si.ForceHistory(
        1e3 * np.sin(np.linspace(0.0, 2.0 * np.pi, 200, endpoint=False)), 0.01, interpolation="periodic"
    )
    periodic = MotionTest(responses(excitation=multisine), mass=MASS, damping_ratio=0.03)
    assert periodic.first is None
    assert len(periodic.searched.scales) == len(periodic.scales)


def test_every_sensor_has_its_own_variance_in_the_search():
    # Two blocks of a line through zero: the estimate with the weights 1/s_b² is that of generalised least squares.
    rng = np.random.default_rng(3)
    slopes, sds = np.concatenate([np.ones(200), np.ones(50)]), np.repeat([1.0, 0.1], [200, 50])
    y = 0.7 * slopes + sds * rng.normal(size=250)
    blocks = (slice(0, 200), slice(200, 250))
    (best,) = refined(lambda x: y - x * slopes, np.zeros((1, 1)), 20, blocks)
    estimate = 0.0
    for _ in range(50):
        squares = [np.mean((y - estimate * slopes)[block] ** 2) for block in blocks]
        weights = np.repeat(1.0 / np.array(squares), [200, 50])
        estimate = (weights * slopes * y).sum() / ((weights * slopes**2).sum() + 1.0)  # with a standard normal prior
    assert best.x[0] == pytest.approx(estimate, rel=1e-6)
    np.testing.assert_allclose(np.sqrt(best.mean_squares), [1.0, 0.1], rtol=0.25)
    (pooled,) = refined(lambda x: y - x * slopes, np.zeros((1, 1)), 20)
    assert abs(pooled.x[0] - estimate) > 0.01


def test_the_evidence_of_two_sensors_is_that_of_quadrature():
    excitation = record(1.5)
    test = MotionTest(responses("linear", noise=0.3, excitation=excitation), mass=MASS, damping_ratio=0.03)
    law = law_of("test", "linear")
    (fit,) = refine_law(test, law, search_law(test.searched, law, 0), [IID()])
    posterior = fit.posterior
    middle, sd = fit.best[0], abs(fit.best[0]) / np.sqrt(fit.minimum.curvature[0, 0])
    nodes, weights = np.polynomial.legendre.leggauss(24)
    stiffness, of_stiffness = middle + 6.0 * sd * nodes, 6.0 * sd * weights
    logs = []
    for square, sensor in zip(fit.minimum.mean_squares, test.sensors, strict=True):
        spread = np.sqrt(2.0 / len(sensor.values))
        logs.append((np.log(square) + 6.0 * spread * nodes, 6.0 * spread * weights))
    grid = np.stack(np.meshgrid(stiffness, np.exp(logs[0][0]), np.exp(logs[1][0]), indexing="ij"), axis=-1).reshape(
        -1, 3
    )
    volumes = np.einsum(
        "i,j,k->ijk", of_stiffness, logs[0][1] * np.exp(logs[0][0]), logs[1][1] * np.exp(logs[1][0])
    ).ravel()
    exact = scipy.special.logsumexp(posterior.log_density(grid), b=volumes)
    assert fit.log_evidence == pytest.approx(exact, abs=0.1)


def test_the_law_of_a_shaken_specimen_is_found(shaken):
    choice = si.choose_model(shaken, ["linear", "elastic_plastic", "bilinear", "pivot"], seed=1)
    assert choice.chosen.law.word == "bilinear"
    assert not choice.chosen.fit.correlated
    assert choice.least_squares < 0.005
    assert "linear" in choice.dropped
    assert choice.mechanisms["hardening"] > 5.0
    assert choice.mechanisms["asymmetric strength"] < -1.0
    assert "The test shows hardening, and no asymmetric strength." in choice.sentence
    mean = dict(zip(choice.result.names, choice.result.mean, strict=True))
    assert mean["stiffness"] == pytest.approx(STIFFNESS, rel=0.02)
    assert "of the motion" in choice.sentence
    with pytest.raises(si.InputError, match="a test under a motion"):
        choice.predict(np.linspace(0.0, 0.01, 30))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"mass": None}, "no mass"),
        ({"values": {"stifness": 1.0}}, "no law has a parameter 'stifness'"),
        ({"values": {"damping_ratio": 0.02}}, "a value and a prior of 'damping_ratio'"),
        ({"measured": []}, "no observation"),
    ],
)
def test_mistakes_get_one_message(shaken, changes, message):
    with pytest.raises(si.InputError, match=message):
        replace(shaken, **changes)


def test_a_cyclic_test_is_refused():
    path = si.DisplacementHistory(0.01 * np.sin(np.linspace(0.0, 9.0, 200)), 1.0)
    force = si.Observation(path, 1e6 * path.values, channels=("restoring_force",))
    with pytest.raises(si.InputError, match="Use CyclicTest"):
        MotionTest(force, mass=MASS)
